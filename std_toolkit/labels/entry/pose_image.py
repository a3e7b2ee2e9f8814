"""Which image of a pose file belongs to a frame of the scene.

Files of several images name them by number (BOP, LabelFusion) or by file name (6D-PAT). A file that
holds another image's pose is refused: its pose would be wrong in the frame without a word.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from std_toolkit.errors import ToolkitError, listed
from std_toolkit.scene.frame_names import file_number, frame_title
from std_toolkit.scene.model import Frame

# LabelFusion's registration_result.yaml holds poses in the first image of its log.
FIRST_IMAGE = "first"


@dataclass(frozen=True)
class WantedImage:
    """The frame whose pose is read.

    Attributes:
        frame: the frame.
        frames: all frames of its scene, which other numbers in the file may refer to.
    """

    frame: Frame
    frames: tuple[Frame, ...]


def choose_image(
    path: Path, images: Sequence[str], given: str | None, wanted: WantedImage | None
) -> str:
    """Return the image in a pose file that is meant.

    Args:
        path: the file, for messages.
        images: images that the file holds: numbers, file names, or `FIRST_IMAGE`.
        given: the image that the user names; it need not be that of the frame.
        wanted: the frame the pose is for; used if `given` is None.

    Raises:
        ToolkitError: the file does not hold this image, or a number in it means two frames.
    """
    if given is not None:
        found = [image for image in images if _is_same(image, given)]
    elif wanted is None:
        found = list(images)
    else:
        found = _of_frame(path, images, wanted)
    if len(found) == 1:
        return found[0]
    hint = "select the image with --pose-frame"
    if given is None and wanted is None:
        raise ToolkitError("the file has several images", path=path, value=len(images), hint=hint)
    if given is not None:
        raise ToolkitError(
            f"no poses for this image; the file holds {_listed(images)}",
            path=path,
            value=given,
            hint=hint,
        )
    assert wanted is not None
    if not found:
        raise ToolkitError(
            f"the file holds {_listed(images)}, not {frame_title(wanted.frame)}",
            path=path,
            hint=f"give another --frame, or --pose-frame {images[0] if images else 'IMAGE'} "
            "if that pose is meant",
        )
    raise ToolkitError(
        f"{_listed(found)} of the file may be {frame_title(wanted.frame)}: one is its id, "
        "one the number of its file",
        path=path,
        hint=hint,
    )


def image_of_labelfusion(path: Path) -> str | None:
    """The image that the name of a LabelFusion file states; None for another name."""
    numbered = re.fullmatch(r"(\d+)_poses", path.stem)
    if numbered is not None:
        return numbered[1]
    return FIRST_IMAGE if path.stem == "registration_result" else None


def _of_frame(path: Path, images: Sequence[str], wanted: WantedImage) -> list[str]:
    """The images that the frame may be; by number, by file name, or as the first."""
    frame = wanted.frame
    names = {frame.name, Path(frame.color).name, frame.color}
    named = [i for i in images if names & {i, Path(i).name, Path(i).stem}]
    if named:
        return named
    if FIRST_IMAGE in images and frame.id == wanted.frames[0].id:
        return [FIRST_IMAGE]
    numbers = {image: int(image) for image in images if image.isdigit()}
    ids = {f.id for f in wanted.frames}
    in_files = {n for f in wanted.frames if (n := file_number(f.name)) is not None}
    by_id = [i for i, n in numbers.items() if n == frame.id]
    by_number = [i for i, n in numbers.items() if n == file_number(frame.name)]
    # If all images of the file are numbers of files, and some no ids, it counts as the files do.
    are_ids, are_numbers = (set(numbers.values()) <= known for known in (ids, in_files))
    if are_numbers and not are_ids:
        return by_number
    if are_ids and not are_numbers:
        return by_id
    found = list(dict.fromkeys([*by_number, *by_id]))
    if len(found) == 1:
        number = numbers[found[0]]
        others = [f for f in wanted.frames if number in (f.id, file_number(f.name)) and f != frame]
        if others:
            raise ToolkitError(
                f"image {number} of the file may be {frame_title(frame)} or "
                f"{frame_title(others[0])}",
                path=path,
                hint=f"give --pose-frame {number} if it is the first",
            )
    return found


def _is_same(image: str, given: str) -> bool:
    if image.isdigit() and given.isdigit():
        return int(image) == int(given)
    return given in (image, Path(image).name, Path(image).stem)


def _listed(images: Sequence[str]) -> str:
    if not images:
        return "no image"
    word = "image" if len(images) == 1 else "images"
    return f"{word} {listed(images, 3)}" + (" alone" if len(images) == 1 else "")
