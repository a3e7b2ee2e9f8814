"""The plane behind an object, such as the table it stands on, from sensor depth around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.labels.support.planefit import find_planes

Array = NDArray[np.float64]

_MOST_POINTS = 1500
_FEWEST_POINTS = 60
# Standard deviation of a table-top stereo sensor across a surface: a + b z.
_NOISE_M, _NOISE_PER_M = 0.001, 0.002


def fit_background(points: NDArray[np.floating], *, share: float = 0.35) -> Array | None:
    """The plane that most points lie on: (4,) = (n, d) with n . p = d, |n| = 1 and d > 0.

    Args:
        points: (N, 3) measured around the object, camera frame, metres.
        share: of the points that must lie on it.

    Returns:
        None if there is no such plane.
    """
    p = np.asarray(points, dtype=np.float64)
    if len(p) < _FEWEST_POINTS:
        return None
    p = p[np.linspace(0, len(p) - 1, min(len(p), _MOST_POINTS)).round().astype(int)]
    sigma = _NOISE_M + _NOISE_PER_M * p[:, 2]
    found = find_planes(p, sigma, np.ones(len(p)), count=1, smallest_weight=share)
    if not found:
        return None
    plane = np.append(found[0].normal, -found[0].offset)
    return plane if plane[3] > 0 else -plane


def plane_depth(plane: Array, directions: Array) -> Array:
    """(N,) z-depth of a plane behind rays (N, 3) with z = 1; inf where they never meet it."""
    along = directions @ plane[:3]
    return np.where(along > 1e-6, plane[3] / np.maximum(along, 1e-6), np.inf)
