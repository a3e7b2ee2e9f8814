"""Events of the controller, and the messages that stay until they are read."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "edited",  # an edit, undo or redo: `objects` lost or gained something
    "preview",  # objects under the mouse moved; nothing is decided yet
    "selected",  # another object is selected
    "frames",  # a view shows another frame
    "view",  # image or cloud, style, opacity, what is drawn
    "look",  # the views should show the whole image ("fit") or come close ("object"): `text`
    "residuals",  # the residuals of `objects` were measured anew
    "penetration",  # where objects run into each other was found anew
    "table",  # the table was found, or found anew
    "tool",  # gizmo, steps, axes, clicking
    "busy",  # a computation began, went on or ended
    "saved",
    "message",  # something to tell the person
    "ask",  # a dialog is wanted: `text` is its name, see `Action.asks`
]

Level = Literal["info", "warning", "error"]

# News vanish when there was time to read them; what has no time here stays until it is closed.
SHOWN_S: dict[Level, float] = {"info": 8.0}


@dataclass(frozen=True)
class Event:
    """One thing that happened.

    Attributes:
        objects: names concerned; empty if it concerns all.
        text: of a message, for people.
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
    """The messages that are shown, the newest last.

    Args:
        show: called with all of them.
        later: calls a function after some seconds.
        seconds: for which messages of a level are shown.
        most: this many are shown at most.
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
        """Show a message; the same one again is not shown twice, and news replace each other."""
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
        """A message was read."""
        if any(n.number == number for n in self.notices):
            self._set([n for n in self.notices if n.number != number])

    def _set(self, notices: list[Notice]) -> None:
        self.notices = notices
        self._show(notices)
