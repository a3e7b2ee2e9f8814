"""One action of the user; mouse gestures for the shortcut sheet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from annotator.app.controller import Controller


@dataclass(frozen=True)
class Action:
    """Command with a menu entry and shortcuts.

    Attributes:
        id: stable name, used by front ends and tests.
        menu: menu of the entry.
        title: text of the menu entry.
        keys: shortcuts, as Qt writes them; the first is shown.
        tip: description in one sentence.
        run: executes the action.
        checked: for switches: returns whether it is on.
        enabled: returns whether the action is available now.
        repeats: whether holding the key repeats the action.
        group: entries of one group are adjacent in the menu; a group whose name starts with a
            capital letter is a submenu of that name.
        label: returns the current title, such as "Undo Move mug"; default: always `title`.
        asks: name of the dialog that it opens; front ends without this dialog omit the action.
    """

    id: str
    menu: str
    title: str
    keys: tuple[str, ...]
    tip: str
    run: Callable[[Controller], Any]
    checked: Callable[[Controller], bool] | None = None
    enabled: Callable[[Controller], bool] = lambda _: True
    repeats: bool = False
    group: str = ""
    label: Callable[[Controller], str] | None = None
    asks: str = ""

    @property
    def submenu(self) -> str:
        """Name of the submenu that contains the entry, or ""."""
        return self.group if self.group[:1].isupper() else ""


def dialog_action(
    id: str,
    menu: str,
    title: str,
    keys: tuple[str, ...],
    tip: str,
    *,
    enabled: Callable[[Controller], bool] = lambda _: True,
    group: str = "",
) -> Action:
    """Return an action that opens the front end's dialog of its name."""
    return Action(
        id, menu, title, keys, tip, lambda c: c.ask(id), enabled=enabled, group=group, asks=id
    )


def has_selected(c: Controller) -> bool:
    """Whether an object is selected and can be edited."""
    return c.selected is not None and c.session.writable


def has_placed(c: Controller) -> bool:
    """Whether the selected object has a pose in the frame of the active view."""
    return has_selected(c) and c.session.pose(str(c.selected), c.active_frame) is not None


def is_idle(c: Controller) -> bool:
    """Whether no computation is running."""
    return c.task is None


def can_queue(c: Controller) -> bool:
    """Whether the selected object has a pose, and a computation can start or wait for its turn."""
    return has_placed(c) and (c.task is None or not c.task.alone)


def can_compute(c: Controller) -> bool:
    """Whether the selected object has a pose and no computation is running."""
    return has_placed(c) and is_idle(c)


@dataclass(frozen=True)
class MouseGesture:
    """Mouse gesture and its effect, as text.

    Attributes:
        gesture: the user's input, such as "Ctrl + drag an object".
        effect: the result.
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
    MouseGesture(
        "Drag a handle",
        "Move along an arrow, or turn along a ring",
    ),
    MouseGesture("Drag the turquoise ring", "Turn the object on the table"),
    MouseGesture("Shift + wheel", "Turn the selected object on the table by one step"),
    MouseGesture("Ctrl + wheel", "Selected object farther or nearer by one step"),
    MouseGesture("Wheel", "Zoom at the pointer"),
    MouseGesture("Drag the background", "Move the image; in the cloud: go around"),
    MouseGesture("Middle or right drag", "Move the image or the cloud"),
    MouseGesture("Click an object", "Select it: of several the foremost"),
    MouseGesture("Double-click a side view", "Its frame into the main view"),
    MouseGesture("Drag a mesh from the library", "Place it on the image"),
    MouseGesture("Points: click mesh, then image", "Add a correspondence"),
    MouseGesture("Points: drag a cross", "Correct its pixel"),
)
