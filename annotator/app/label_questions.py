"""Questions about labels: objects that are not known to fit, and propagation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from annotator.app.questions import Answers, Button, Field, Question, Reaction
from std_toolkit.options import PropagateOptions

if TYPE_CHECKING:
    from annotator.session import Session


def doubt_question(doubts: Sequence[tuple[str, str]], react: Reaction) -> Question:
    """Ask whether to mark objects as done whose verdict is not good: "done" or "".

    Args:
        doubts: name and reason of each object.
    """
    names = ", ".join(name for name, _ in doubts)
    return Question(
        f"{names}: not known to fit",
        react,
        text=f"{_listed(doubts)}\n\nA label marked as done counts as checked by you.",
        level="warning",
        buttons=(
            Button("", "Go back", "The object stays open."),
            Button("done", "Mark as done anyway", "You have checked it by eye."),
        ),
    )


def _listed(doubts: Sequence[tuple[str, str]]) -> str:
    return "\n".join(f"{name}: {reason}" for name, reason in doubts)


def propagate_question(
    session: Session, doubts: Sequence[tuple[str, str]], react: Reaction
) -> Question:
    """Ask for the options of propagation; see `propagate_options`.

    Args:
        doubts: name and reason of the objects whose verdict is not good.
    """
    placed = [o for o in session.state.objects if o.placements]
    undone = [o.name for o in placed if o.status != "done"]
    objects = "1 object" if len(placed) == 1 else f"{len(placed)} objects"
    text = (
        f"The labels are saved, and the poses of {objects} are carried to "
        f"{len(session.frames)} frames through the camera poses."
    )
    if undone:
        text += f"\n\nNot marked as done yet: {', '.join(undone)}."
    if doubts:
        text += "\n\nNot confirmed:\n" + _listed(doubts)
    refining = ("refine", (True,))
    return Question(
        "Save and propagate",
        react,
        text=text,
        level="warning" if doubts else "info",
        fields=(
            Field(
                "refine",
                "Adjust each pose to several frames at once",
                kind="switch",
                value=False,
                tip="Takes minutes; the images decide, not the poses set by hand.",
            ),
            Field(
                "scale",
                "Estimate the scale of the camera poses as well",
                kind="switch",
                value=False,
                tip="Rewrites poses.json with it: for scenes whose metric scale comes from sensor "
                "depth alone.",
                when=refining,
            ),
            Field(
                "depth",
                "Use the sensor depth on raw and diffuse objects",
                kind="switch",
                value=True,
                when=refining,
            ),
            Field(
                "keyframes",
                "Adjust to",
                kind="number",
                value=10,
                least=2,
                most=200,
                unit="frames",
                when=refining,
            ),
        ),
        buttons=(
            Button("go", "Save and propagate"),
            Button("", "Cancel", "Nothing is written."),
        ),
    )


def propagate_options(answers: Answers) -> PropagateOptions:
    """Return the selected options."""
    return PropagateOptions(
        refine=answers["refine"],
        refine_scale=answers["scale"],
        use_depth=answers["depth"],
        keyframes=answers["keyframes"],
    )
