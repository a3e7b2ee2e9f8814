"""What a controller tells its views and panels."""

from __future__ import annotations

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
