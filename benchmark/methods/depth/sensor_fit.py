"""Scale and shift of a prediction by the measurements of its frame."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Floats, Mask
from std_toolkit.errors import ToolkitError

# Measurements whose neighbours differ by more than this share lie at an edge, or are noise.
_SMOOTH = 0.02
_FEWEST = 50
# Rounds of the fit, and residuals of so many deviations (by the median) that the next leaves out.
_ROUNDS, _FAR = 8, 3.0


def trusted_pixels(depth: Floats) -> Mask:
    """Measurements that all eight neighbours confirm within 2 %.

    Args:
        depth: (h, w) metres, 0 where nothing was measured.

    Returns:
        (h, w) bool.
    """
    window = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(depth, window), cv2.dilate(depth, window)
    return (low > 0) & (high - low <= _SMOOTH * depth)


def fit_line(predicted: NDArray[Any], known: NDArray[Any], where: Mask) -> tuple[float, float]:
    """Scale and shift from predictions to what is known, without what then lies far off.

    Args:
        predicted, known: (h, w).
        where: (h, w) pixels to use.

    Returns:
        scale, shift: `scale * predicted + shift` is near `known`.

    Raises:
        ToolkitError: fewer than 50 pixels, a prediction without any structure, or one that fits
            only upside down.
    """
    x = np.asarray(predicted, np.float64)[where]
    y = np.asarray(known, np.float64)[where]
    if len(x) < _FEWEST or not np.ptp(x) > 0:
        raise ToolkitError(
            "too few measurements that their neighbours confirm, or a flat answer",
            field="fit",
            value=f"{len(x)} pixels",
            hint="--set fit=none with --protocol aligned-frame",
        )
    kept = np.ones(len(x), bool)
    scale, shift = 1.0, 0.0
    for _ in range(_ROUNDS):
        matrix = np.stack([x[kept], np.ones(kept.sum())], axis=1)
        scale, shift = np.linalg.lstsq(matrix, y[kept], rcond=None)[0]
        off = np.abs(scale * x + shift - y)
        within = off <= _FAR * 1.4826 * max(float(np.median(off)), 1e-9)
        if (within == kept).all() or within.sum() < _FEWEST:
            break
        kept = within
    if scale <= 0:
        raise ToolkitError(
            "the answer grows where the measurements fall: no scale above 0 fits it to them",
            field="fit",
            value=f"scale {scale:.3g}",
            hint="--set fit=none with --protocol aligned-frame",
        )
    return float(scale), float(shift)
