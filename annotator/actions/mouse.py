"""What the mouse does in the views, for the shortcut sheet of every front end."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MouseGesture:
    """One thing that the mouse does.

    Attributes:
        gesture: what the hand does.
        effect: what comes of it.
    """

    gesture: str
    effect: str


MOUSE = (
    MouseGesture(
        "Drag an object",
        "Move it across the view; also in the side views. The selected one is taken even where it "
        "is behind another",
    ),
    MouseGesture("Ctrl + drag an object", "Slide it along the table"),
    MouseGesture("Shift + drag an object", "Turn it like a ball"),
    MouseGesture("Drag a handle", "Move along an arrow, or turn along a ring"),
    MouseGesture("Ctrl + wheel", "Selected object farther or nearer by one step"),
    MouseGesture("Shift + wheel", "The same by a tenth of a step"),
    MouseGesture("Wheel", "Zoom at the pointer"),
    MouseGesture("Drag the background", "Move the image; in the cloud: go around"),
    MouseGesture("Middle or right drag", "Move the image or the cloud"),
    MouseGesture("Click an object", "Select it: of several the foremost"),
    MouseGesture("Double-click a side view", "Its frame into the main view"),
    MouseGesture("Drag a mesh from the library", "Place it on the image"),
    MouseGesture("Points: click mesh, then image", "Add a correspondence"),
    MouseGesture("Points: drag a cross", "Correct its pixel"),
)
