"""The pieces of a frame, put together: what every loader checks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.data.source import FrameKey
from std_toolkit.errors import ToolkitError

NO_COLOR = np.zeros((0, 0, 3), np.uint8)
NO_DEPTH = np.zeros((0, 0), np.float32)
for _array in (NO_COLOR, NO_DEPTH):
    _array.flags.writeable = False


def first_file(folder: Path, names: tuple[str, ...], what: str) -> Path:
    """The first of these files that is there.

    Raises:
        ToolkitError: none is.
    """
    for name in names:
        path = folder / name
        if path.is_file():
            return path
    others = f" (nor {', '.join(names[1:])})" if len(names) > 1 else ""
    raise ToolkitError(
        f"the frame has no {what}: no such file{others}",
        path=folder / names[0],
        hint="is the download complete? --check-data lists all that is missing",
    )


def check_proportions(path: Path, image: NDArray[np.generic], size: tuple[int, int]) -> None:
    """Refuse an image that does not show the same view as the ground truth.

    Args:
        path: of the image.
        image: (H, W) or (H, W, C).
        size: (width, height) of the ground truth.

    Raises:
        ToolkitError: other proportions.
    """
    height, width = image.shape[:2]
    if width * size[1] != height * size[0]:
        raise ToolkitError(
            f"has other proportions than the ground truth's {size[0]}x{size[1]}",
            path=path,
            value=f"{width}x{height}",
            hint="colour, raw depth and ground truth must be aligned",
        )


def check_same_size(
    path: Path, image: NDArray[np.generic], reference: NDArray[np.generic], what: str
) -> None:
    """Refuse a map of another size than the ground truth's depth.

    Raises:
        ToolkitError: the sizes differ.
    """
    if image.shape[:2] != reference.shape[:2]:
        raise ToolkitError(
            f"the {what} has another size than the ground-truth depth's "
            f"{reference.shape[1]}x{reference.shape[0]}",
            path=path,
            value=f"{image.shape[1]}x{image.shape[0]}",
        )


def about(error: ToolkitError, key: FrameKey, path: Path) -> ToolkitError:
    """What a frame says of itself, told with the file that is to blame."""
    if error.path is None or error.path == str(key):
        return ToolkitError(
            error.problem, path=path, field=error.field, value=error.value, hint=error.hint
        )
    return error
