"""Where a mug's handle is, and whether a frame shows it.

A mug whose handle is hidden looks the same from all sides: nobody can tell its turn about y. A mug
stands on y; its body is round, and as wide as the mug is across the handle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# So much farther from the body's axis than the body is wide, a point belongs to the handle.
_BEYOND = 1.1
# A mug that is not longer than wide by so much has no handle, or one that sticks out nowhere.
_LEAST_LENGTH = 1.1
# Of the surface of a mug; more of it outside the body means that the body is at the other side.
_LARGEST_SHARE = 0.3
# So few pixels of a handle may be a rim that the renderer drew half a pixel too wide.
LEAST_HANDLE_PIXELS = 10


@dataclass(frozen=True)
class MugHandle:
    """The body of a mug, in normalised coordinates with the middle of the box at 0.

    Attributes:
        axis: 0 or 2, along which the handle sticks out.
        centre: of the body along that axis.
        radius: of the body.
    """

    axis: int
    centre: float
    radius: float

    def pixels(self, coordinates: NDArray[np.floating]) -> int:
        """How many of the coordinates (N, 3) are of the handle."""
        return int((_distance(coordinates, self.axis, self.centre) > _BEYOND * self.radius).sum())

    def is_visible(self, coordinates: NDArray[np.floating]) -> bool:
        """Whether the coordinates (N, 3) of a mug's pixels show its handle."""
        return self.pixels(coordinates) >= LEAST_HANDLE_PIXELS


def find_handle(points: NDArray[np.floating], areas: NDArray[np.floating]) -> MugHandle | None:
    """The handle of a mug.

    Args:
        points: (N, 3) on its surface, in normalised coordinates with the middle of the box at 0.
        areas: (N,) of the surface that each stands for.

    Returns:
        None where nothing sticks out of a round body.
    """
    p, a = np.asarray(points, np.float64), np.asarray(areas, np.float64)
    half = np.abs(p).max(axis=0)
    axis = 0 if half[0] > half[2] else 2
    radius = float(half[2 - axis])
    if not half[axis] > _LEAST_LENGTH * radius > 0:
        return None
    offset = float(half[axis] - radius)
    shares = {
        centre: a[_distance(p, axis, centre) > _BEYOND * radius].sum() / a.sum()
        for centre in (-offset, offset)
    }
    centre = min(shares, key=lambda c: shares[c])
    if not 0 < shares[centre] < _LARGEST_SHARE:
        return None
    return MugHandle(axis, centre, radius)


def _distance(points: NDArray[np.floating], axis: int, centre: float) -> Floats:
    """(N,) from the body's axis."""
    return np.hypot(points[:, axis] - centre, points[:, 2 - axis]).astype(np.float64)
