"""Events of the controller and its messages."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "edited",  # an edit, undo or redo changed `objects`
    "preview",  # dragged objects moved; not committed yet
    "selected",  # another object is selected
    "frames",  # a view shows another frame
    "view",  # image or cloud, style, opacity, what is drawn
    "look",  # views show the whole image ("fit") or zoom to the object ("object"): `text`
    "residuals",  # the residuals of `objects` were measured
    "verdict",  # rank or texture comparison of `objects` are known
    "penetration",  # penetrations were computed
    "table",  # the table was found
    "tool",  # gizmo, steps, axes, clicking
    "library",  # the library shows the meshes of another folder
    "busy",  # a computation started, progressed or ended
    "saved",
    "message",  # text for the user
    "ask",  # a dialog is requested: `text` is its name, see `Action.asks`
]

Level = Literal["info", "warning", "error"]

# Display time by level; messages of other levels stay until closed.
SHOWN_S: dict[Level, float] = {"info": 8.0}


@dataclass(frozen=True)
class Event:
    """Change reported to listeners.

    Attributes:
        objects: names of the changed objects; empty for all.
        text: of a message.
        level: of a message.
    """

    kind: Kind
    objects: tuple[str, ...] = ()
    text: str = ""
    level: Level = "info"


@dataclass(frozen=True)
class Notice:
    """One message."""

    number: int
    text: str
    level: Level


class Notices:
    """The displayed messages, newest last.

    Args:
        show: called with all of them.
        later: calls a function after a delay in seconds.
        seconds: display time by level.
        most: largest number of messages shown.
    """

    def __init__(
        self,
        show: Callable[[list[Notice]], None],
        later: Callable[[float, Callable[[], None]], None],
        *,
        seconds: Mapping[Level, float] = SHOWN_S,
        most: int = 30,
    ) -> None:
        self._show, self._later, self._seconds, self._most = show, later, seconds, most
        self._numbers = itertools.count(1)
        self.notices: list[Notice] = []

    def tell(self, text: str, level: Level = "info") -> None:
        """Show a message; a repeated one is shown once, and an info replaces the previous info."""
        notice = Notice(next(self._numbers), text, level)
        kept = [
            n
            for n in self.notices
            if n.text != text and not (n.level == "info" and level == "info")
        ]
        self._set([*kept, notice][-self._most :])
        if level in self._seconds:
            self._later(self._seconds[level], lambda: self.close(notice.number))

    def clear(self) -> None:
        """Close all messages."""
        self._set([])

    def close(self, number: int) -> None:
        """Close a message."""
        if any(n.number == number for n in self.notices):
            self._set([n for n in self.notices if n.number != number])

    def _set(self, notices: list[Notice]) -> None:
        self.notices = notices
        self._show(notices)
