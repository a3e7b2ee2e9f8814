"""What the correlation needs of each image alone: sums and spreads of its windows, exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Standard deviation, in grey levels, that is added to every window's: without it the noise of
# textureless places would correlate by chance as strongly as a pattern does.
NOISE_LEVELS = 1.0


def window_sums(
    padded: NDArray[np.uint8], size: int
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Sum of every window of size x size, and 1 / (pixels times standard deviation).

    Args:
        padded: (H + size - 1, W + size - 1).

    Returns:
        (H, W) int32 and (H, W) float64.
    """
    values = padded.astype(np.int64)
    total, squares = _box(values, size), _box(values * values, size)
    pixels = size * size
    spread = pixels * squares - total * total + (NOISE_LEVELS * pixels) ** 2
    return total.astype(np.int32), 1.0 / np.sqrt(spread.astype(np.float64))


def _box(values: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    for axis in (0, 1):
        sums = np.cumsum(values, axis=axis)
        sums = np.insert(sums, 0, 0, axis=axis)
        end = sums.shape[axis]
        values = np.take(sums, range(size, end), axis) - np.take(sums, range(end - size), axis)
    return values
