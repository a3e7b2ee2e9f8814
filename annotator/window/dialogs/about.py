"""What this program is."""

from __future__ import annotations

from PySide6.QtWidgets import QWidget

from annotator.window.dialogs.question import Answer, Question
from annotator.window.graphics import renderer_name
from std_toolkit import __version__


def about_box(parent: QWidget | None) -> Question:
    """Version, guide, and what draws the views."""
    text = (
        f"Version {__version__}\n\n"
        "Aligns the CAD meshes of objects to a recorded scene. The guide is docs/annotating.md.\n\n"
        f"Views are drawn by {renderer_name() or 'an unknown renderer'}."
    )
    return Question(parent, "std-annotate", text, [Answer("close", "Close")])
