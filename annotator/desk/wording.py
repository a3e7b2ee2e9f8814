"""Sentences about a session that the window and the page say alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from annotator.session import Session
    from std_toolkit.scene import SymmetryModel

_AXES = ("x", "y", "z")


def propagation_text(session: Session) -> str:
    """What propagating does now, and which objects are not done yet."""
    placed = [o for o in session.state.objects if o.placements]
    undone = [o.name for o in placed if o.status != "done"]
    text = (
        f"The labels are saved, and the poses of {len(placed)} objects are carried to "
        f"{len(session.frames)} frames through the camera poses."
    )
    if undone:
        text += f"\n\nNot marked as done yet: {', '.join(undone)}."
    return text


def symmetry_text(symmetry: SymmetryModel) -> str:
    """A symmetry in full, for who is about to change it."""
    parts = []
    for one in symmetry.continuous:
        axis = next((a for a, x in zip(_AXES, one.axis, strict=True) if abs(x) > 0.999), None)
        parts.append(f"any turn about {axis or 'an axis of its own'}")
    if symmetry.discrete:
        parts.append(f"{len(symmetry.discrete)} turns")
    return ", ".join(parts) or "none told"


def symmetry_summary(symmetry: SymmetryModel) -> str:
    """A symmetry in a few words, for a tool tip."""
    if symmetry.continuous:
        return "symmetric about an axis"
    if symmetry.discrete:
        return f"{len(symmetry.discrete)} turns that look the same"
    return "no symmetry told"
