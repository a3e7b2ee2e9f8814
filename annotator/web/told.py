"""What a page tells the server over the channel of its views; checked as it is read."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

# A held button is followed beyond the edges of its view, but not to infinity.
Share = Annotated[float, Meta(ge=-20, le=20)]
Pixels = Annotated[int, Meta(ge=0, le=16384)]
View = Annotated[int, Meta(ge=0, le=63)]


class Pointer(msgspec.Struct, tag="pointer", frozen=True, forbid_unknown_fields=True):
    """The mouse, a pen or a finger did something in a view.

    Attributes:
        x, y: where, as shares of the picture from its top left corner.
        button: 0 left, 1 middle, 2 right.
        notches: how far a wheel was turned; up, which is away from the hand, is positive.
        number: of a move, which the server answers as soon as it has followed it.
    """

    view: View
    kind: Literal["down", "move", "up", "cancel", "leave", "wheel", "double"]
    x: Share = 0.0
    y: Share = 0.0
    button: Annotated[int, Meta(ge=0, le=2)] = 0
    notches: Annotated[int, Meta(ge=-10, le=10)] = 0
    number: int = 0
    shift: bool = False
    ctrl: bool = False
    alt: bool = False


class Key(msgspec.Struct, tag="key", frozen=True, forbid_unknown_fields=True):
    """A key was pressed, named as in the table of actions: "Ctrl+Shift+Z"."""

    name: Annotated[str, Meta(max_length=40)]
    repeat: bool = False


class Sizes(msgspec.Struct, tag="sizes", frozen=True, forbid_unknown_fields=True):
    """Size of each view on the screen.

    Attributes:
        sizes: width and height in physical pixels; 0 for one that is not shown.
        ratio: physical pixels per logical one.
    """

    sizes: Annotated[list[tuple[Pixels, Pixels]], Meta(max_length=64)]
    ratio: Annotated[float, Meta(ge=0.1, le=16)] = 1.0


class Shown(msgspec.Struct, tag="shown", frozen=True, forbid_unknown_fields=True):
    """A picture is on the screen."""

    view: View
    number: int


class Sight(msgspec.Struct, tag="sight", frozen=True, forbid_unknown_fields=True):
    """Whether the page can be seen: one in a hidden tab gets no pictures."""

    visible: bool


class Drop(msgspec.Struct, tag="drop", frozen=True, forbid_unknown_fields=True):
    """A mesh of the library, or an object of the list, was dropped onto a view."""

    view: View
    x: Share
    y: Share
    what: Literal["model", "object"]
    name: Annotated[str, Meta(max_length=200)]


Told = Pointer | Key | Sizes | Shown | Sight | Drop
_decoder = msgspec.json.Decoder(Told)


def read_told(text: str | bytes) -> Told:
    """Raises msgspec.ValidationError or DecodeError for what no page of ours sends."""
    return _decoder.decode(text)
