"""Events of the controller, and the messages that stay until they are read.

What the page has to tell: messages that stay until they are read.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

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

# News vanish when there was time to read them; warnings and errors stay until they are closed.
INFO_S = 8.0

MOST = 30


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
    """The messages on the page, the newest last.

    Args:
        show: hands all of them to the page, as plain values.
        later: calls a function after some seconds.
    """

    def __init__(
        self,
        show: Callable[[list[dict[str, Any]]], None],
        later: Callable[[float, Callable[[], None]], None],
    ) -> None:
        self._show, self._later = show, later
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
        self._set([*kept, notice][-MOST:])
        if level == "info":
            self._later(INFO_S, lambda: self.close(notice.number))

    def close(self, number: int) -> None:
        """A message was read."""
        if any(n.number == number for n in self.notices):
            self._set([n for n in self.notices if n.number != number])

    def _set(self, notices: list[Notice]) -> None:
        self.notices = notices
        self._show([asdict(n) for n in notices])
