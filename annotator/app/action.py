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
        problem: returns why the action is not available now, such as "no object is selected"; ""
            if it is.
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
    problem: Callable[[Controller], str] = lambda _: ""
    repeats: bool = False
    group: str = ""
    label: Callable[[Controller], str] | None = None
    asks: str = ""

    def enabled(self, c: Controller) -> bool:
        """Whether the action is available now."""
        return not self.problem(c)

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
    checked: Callable[[Controller], bool] | None = None,
    problem: Callable[[Controller], str] = lambda _: "",
    group: str = "",
) -> Action:
    """Return an action that opens the front end's dialog of its name."""
    return Action(
        id, menu, title, keys, tip, lambda c: c.ask(id), checked, problem, group=group, asks=id
    )


# Why an action is not available: "" if it is.


def read_only(c: Controller) -> str:
    """Say that the scene cannot be changed."""
    return "" if c.session.writable else "the scene is read-only"


def none_selected(c: Controller) -> str:
    """Say that there is no selected object that can be edited."""
    return read_only(c) or ("" if c.selected is not None else "no object is selected")


def not_placed(c: Controller) -> str:
    """Say that the selected object has no pose in the frame of the active view."""
    problem = none_selected(c)
    if not problem and c.session.pose(str(c.selected), c.active_frame) is None:
        problem = f"{c.selected} has no pose in frame {c.active_frame}"
    return problem


def busy(c: Controller) -> str:
    """Say which computation is running."""
    return "" if c.task is None else f"{c.task.title} is still running"


def blocked(c: Controller) -> str:
    """Say which computation is running that others cannot wait for."""
    return busy(c) if c.task is not None and c.task.alone else ""


def cannot_compute(c: Controller) -> str:
    """Say why no computation on the selected object can start, or wait for its turn."""
    return not_placed(c) or blocked(c)


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
