"""Nearest-neighbour resizing with the very indices of `torch.nn.functional.interpolate`."""

from __future__ import annotations

from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

Size = tuple[int, int]  # (width, height), as everywhere in the toolkit
T = TypeVar("T", bound=np.generic)


@lru_cache(maxsize=256)
def nearest_indices(length: int, wanted: int) -> NDArray[np.intp]:
    """Which of `length` samples each of `wanted` samples takes.

    Args:
        length: samples along an axis of the source.
        wanted: samples along that axis of the result.

    Returns:
        (wanted,) read-only indices: `floor(i * length / wanted)` with quotient, product and floor
        in float32. Torch computes so for float32 tensors, and another precision gives another
        index for about one pair of lengths in sixty.

    Raises:
        ToolkitError: a length below 1, or beyond 2**24, where float32 cannot count.

    >>> nearest_indices(5, 3).tolist()
    [0, 1, 3]
    """
    for name, value in (("length", length), ("wanted", wanted)):
        if not 1 <= value <= 2**24:
            raise ToolkitError("is no length of an image", field=name, value=value)
    scale = np.float32(length) / np.float32(wanted)
    exact = np.floor(np.arange(wanted, dtype=np.float32) * scale)
    indices = np.minimum(exact.astype(np.intp), length - 1)
    indices.flags.writeable = False
    return indices


@lru_cache(maxsize=32)
def pixels_taken(size: Size, *steps: Size) -> NDArray[np.intp] | None:
    """Which pixels of an image are left after it was resized to each of `steps` in turn.

    Args:
        size: (width, height) of the image.
        steps: sizes that it goes through, the last one being that of the result.

    Returns:
        (height * width of the last step,) read-only indices into the flat image, row by row;
        None where every pixel stays in its place.

    Raises:
        ToolkitError: a size without pixels.

    >>> pixels_taken((4, 2), (2, 2)).tolist()
    [0, 2, 4, 6]
    >>> pixels_taken((4, 2), (4, 2)) is None
    True
    """
    columns, rows = nearest_indices(size[0], size[0]), nearest_indices(size[1], size[1])
    before = size
    for step in steps:
        columns = columns[nearest_indices(before[0], step[0])]
        rows = rows[nearest_indices(before[1], step[1])]
        before = step
    if before == size and all(step == size for step in steps):
        return None
    taken = (rows[:, None] * size[0] + columns).ravel()
    taken.flags.writeable = False
    return taken


def resize_nearest(image: NDArray[T], size: Size) -> NDArray[T]:
    """An image at another size, each pixel being one of the source.

    Args:
        image: (H, W) or (H, W, C) of any type.
        size: wanted (width, height).

    Returns:
        (height, width) or (height, width, C); a new array, also where the size stays.

    Raises:
        ToolkitError: not an image, or a size without pixels.

    >>> resize_nearest(np.arange(8).reshape(2, 4), (2, 1)).tolist()
    [[0, 2]]
    """
    if image.ndim not in (2, 3):
        raise ToolkitError("must be (H, W) or (H, W, C)", field="image", value=image.shape)
    rows = nearest_indices(image.shape[0], size[1])
    columns = nearest_indices(image.shape[1], size[0])
    return image.take(rows, axis=0).take(columns, axis=1)
