"""Frames by what a user types: an id, a name, or a file name.

Ids count the frames of a scene, file names often have numbers of their own: frame 12 may be
`color/000036.jpg`. A number that means two frames is refused.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from std_toolkit.errors import ToolkitError, listed
from std_toolkit.scene.model import Frame

_SHOWN = 3


def file_number(name: str) -> int | None:
    """The last whole number in the name of a file, without its extension; None without digits.

    >>> file_number("color_000036")
    36
    """
    digits = re.findall(r"\d+", name)
    return int(digits[-1]) if digits else None


def frame_title(frame: Frame) -> str:
    """Id and colour file of a frame, such as "frame 12 = color/000036.jpg"."""
    return f"frame {frame.id} = {frame.color}"


def find_frame(frames: Sequence[Frame], given: str | int, *, root: Path | str) -> Frame:
    """Return the frame that a user names.

    Args:
        frames: frames of the scene.
        given: a frame's file (colour or depth, with or without its folder), its name, its id, or
            the number in its file name. Digits with leading zeros are a name if a frame has it.
        root: scene folder, for messages.

    Raises:
        ToolkitError: no such frame, or a number that is the id of one frame and in the file name
            of another. A file name with its extension is never ambiguous in a folder of images.
    """
    text = str(given).strip()
    by_file = [f for f in frames if text and text in _file_names(f)]
    if len(by_file) == 1:
        return by_file[0]
    if by_file:
        raise ToolkitError(
            "several frames have this file name",
            path=root,
            value=given,
            hint=f"give its folder, too: {listed([f.color for f in by_file], _SHOWN)}",
        )
    named = [f for f in frames if f.name == text]
    is_number = text.isascii() and text.isdigit()
    if named and not (is_number and text == str(int(text))):
        return named[0]
    number = int(text) if is_number and len(text) < 19 else None
    meanings: dict[int, tuple[Frame, str]] = {f.id: (f, "the name of") for f in named}
    if number is not None:
        for f in frames:
            if file_number(f.name) == number:
                meanings.setdefault(f.id, (f, "the number of"))
        meanings |= {f.id: (f, "the id of") for f in frames if f.id == number}
    if len(meanings) == 1:
        return next(iter(meanings.values()))[0]
    if meanings:
        files = [f.color for f, _ in meanings.values()]
        said = listed([f"{how} {f.color}" for f, how in meanings.values()], _SHOWN, " and ")
        raise ToolkitError(
            f"this number means several frames: it is {said}",
            path=root,
            value=given,
            hint=f"give the file name: {listed([Path(x).name for x in files], _SHOWN, ' or ')}",
        )
    raise ToolkitError(
        f"no such frame; {_range(frames)}",
        path=root,
        value=given,
        hint="`std-curate info SCENE --frames` lists them",
    )


def _file_names(frame: Frame) -> set[str]:
    """The colour and depth file, each with and without its folder."""
    return {x for p in (frame.color, frame.depth) if p for x in (p, Path(p).name)}


def _range(frames: Sequence[Frame]) -> str:
    if not frames:
        return "the scene has no frames"
    first, last = frames[0], frames[-1]
    return (
        f"the scene has {len(frames)} frames, ids {first.id} to {last.id}, "
        f"{first.color} to {last.color}"
    )
