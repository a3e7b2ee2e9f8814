"""Pixels beside a step of depth or the outline of an object, where restorers smear."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND

STEP = 1.02  # ratio between neighbouring depths: 1 cm at half a metre
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
    for one, two in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        edge = _edges(m[one], m[two], g[one], g[two])
        beside[one] |= edge
        beside[two] |= edge
    if width > 1:
        kernel = np.ones((2 * width - 1, 2 * width - 1), np.uint8)
        band[window] = cv2.dilate(np.ascontiguousarray(beside), kernel)
    return band


def _edges(
    mask_a: NDArray[np.uint8],
    mask_b: NDArray[np.uint8],
    true_a: NDArray[np.float32],
    true_b: NDArray[np.float32],
) -> NDArray[np.uint8]:
    nearer, farther = np.minimum(true_a, true_b), np.maximum(true_a, true_b)
    step = (farther > np.float32(STEP) * nearer) & (nearer > 0)
    return (step | (mask_a != mask_b)).view(np.uint8)
