"""Which pixels a stereo camera can measure at all: seen by both eyes, away from steps in depth."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

WINDOW_PX = 7
"""Half of the local matcher's window: 9 pixels summed of costs that look 3 further each way."""
STEP_PX = 1.5
"""Difference in disparity across which a window sees two surfaces."""
_OCCLUDED_PX = 1.0


def clear_of_steps(
    exact: NDArray[np.floating], *, focal_px: float, baseline_m: float
) -> NDArray[np.bool_]:
    """Pixels whose whole window lies on one surface that both eyes see.

    Args:
        exact: (h, w) true z-depth in the left camera, metres, 0 = none.

    Returns:
        (h, w) bool. The rest holds the strip at the left edge that the right eye does not see,
        the shadows beside near things, and their borders.
    """
    known = exact > 0
    disparity = np.zeros(exact.shape, np.float32)
    np.divide(focal_px * baseline_m, exact, out=disparity, where=known, casting="unsafe")
    column = np.arange(exact.shape[1], dtype=np.float32)
    in_right = column - disparity
    # A nearer thing further right lands on the same column, or left of it, in the right image.
    nearest = np.minimum.accumulate(in_right[:, ::-1], axis=1)[:, ::-1]
    hidden = known & (in_right - nearest > _OCCLUDED_PX)
    window = np.ones((2 * WINDOW_PX + 1, 2 * WINDOW_PX + 1), np.uint8)
    small = np.ones((3, 3), np.uint8)
    # Over three pixels even a steep slope changes little, a step all of its height.
    step = cv2.dilate(disparity, small) - cv2.erode(disparity, small) > STEP_PX
    mixed = cv2.dilate((step | hidden).astype(np.uint8), window) > 0
    return np.asarray(known & (in_right >= WINDOW_PX) & ~mixed)
