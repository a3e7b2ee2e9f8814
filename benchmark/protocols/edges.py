"""Pixels beside a step of depth or the outline of an object, where restorers smear."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND

STEP = 1.02  # ratio between neighbouring depths: 1 cm at half a metre
_ROWS_AT_ONCE = 32  # whose intermediate figures stay in the processor's cache
COLUMNS_PER_PIXEL = 200  # the band is one pixel wide per this many columns, on each side


def band_width(columns: int) -> int:
    """Pixels on each side of an edge that belong to it, in an image of so many columns.

    >>> band_width(224), band_width(640), band_width(1280)
    (1, 3, 6)
    """
    return max(1, round(columns / COLUMNS_PER_PIXEL))


def edge_band(true: NDArray[np.float32], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pixels within `band_width` of an edge of the ground truth.

    An edge runs between two neighbours in a row or column that belong to different objects (or
    one to none), or whose true depths, both there, differ by more than 2 %. The distance is the
    larger one of rows and columns.

    Args:
        true: (H, W) true metres, 0 where there is none.
        mask: (H, W) ids of objects, `BACKGROUND` elsewhere.

    Returns:
        (H, W) 1 within the band, 0 elsewhere; outside of objects nothing is looked for.

    >>> edge_band(np.array([[1, 1, 1, 2, 2]], np.float32), np.zeros((1, 5), np.uint8)).tolist()
    [[0, 0, 1, 1, 0]]
    """
    band = np.zeros(mask.shape, np.uint8)
    width = band_width(mask.shape[1])
    x, y, columns, rows = cv2.boundingRect((mask != BACKGROUND).view(np.uint8))
    if columns == 0:
        return band
    top, left = max(0, y - width), max(0, x - width)
    window = np.s_[top : y + rows + width, left : x + columns + width]
    m, g, beside = mask[window], true[window], band[window]
    # Where there is no depth there is no step: NaN passes no comparison.
    g = np.where(g > 0, g, np.float32(np.nan))
    for begin in range(0, len(g), _ROWS_AT_ONCE):
        # One row more, for the edges between this part and the next.
        part = np.s_[begin : begin + _ROWS_AT_ONCE + 1]
        for axis in (0, 1):
            _mark_edges(m[part], g[part], beside[part], axis)
    if width > 1:
        kernel = np.ones((2 * width - 1, 2 * width - 1), np.uint8)
        band[window] = cv2.dilate(np.ascontiguousarray(beside), kernel)
    return band


def _mark_edges(
    mask: NDArray[np.uint8], true: NDArray[np.float32], marked: NDArray[np.uint8], axis: int
) -> None:
    """Mark the pixels on both sides of the edges between neighbours along an axis."""
    one, two = ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:]))[axis]
    a, b = true[one], true[two]
    far = np.maximum(a, b)
    near = np.minimum(a, b)
    near *= np.float32(STEP)
    edge = far > near
    edge |= mask[one] != mask[two]
    found = edge.view(np.uint8)
    marked[one] |= found
    marked[two] |= found
