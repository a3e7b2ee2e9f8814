"""Distances between many points at two poses, in space and in the image, compiled."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from std_toolkit.compiled import compiled

Floats = NDArray[np.float64]


@partial(compiled, error_model="numpy")
def pinhole_distances(
    points: Floats, P: Floats, p: Floats, Q: Floats, q: Floats
) -> tuple[Floats, Floats]:
    """Squared distances in the image between points under two projections.

    Args:
        points: (3, V).
        P, p: (3, 3) and (3,): P x + p is the homogeneous pixel of x; its third entry is the depth.
        Q, q: of the other projection.

    Returns:
        (V,) square pixels, and (V,) the smaller of both depths.
    """
    count = points.shape[1]
    apart, depth = np.empty(count), np.empty(count)
    for i in range(count):
        x, y, z = points[0, i], points[1, i], points[2, i]
        d = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + p[2]
        e = Q[2, 0] * x + Q[2, 1] * y + Q[2, 2] * z + q[2]
        depth[i] = d if d < e else e
        # u/d - v/e with one division.
        scale = 1 / (d * e)
        u = P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + p[0]
        v = Q[0, 0] * x + Q[0, 1] * y + Q[0, 2] * z + q[0]
        across = (u * e - v * d) * scale
        u = P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + p[1]
        v = Q[1, 0] * x + Q[1, 1] * y + Q[1, 2] * z + q[1]
        down = (u * e - v * d) * scale
        apart[i] = across * across + down * down
    return apart, depth


@compiled
def largest_move(points: Floats, A: Floats, a: Floats) -> float:
    """Largest |A x + a|².

    Args:
        points: (3, V).
        A, a: (3, 3) and (3,).
    """
    largest = 0.0
    for i in range(points.shape[1]):
        x, y, z = points[0, i], points[1, i], points[2, i]
        u = A[0, 0] * x + A[0, 1] * y + A[0, 2] * z + a[0]
        v = A[1, 0] * x + A[1, 1] * y + A[1, 2] * z + a[1]
        w = A[2, 0] * x + A[2, 1] * y + A[2, 2] * z + a[2]
        largest = max(largest, u * u + v * v + w * w)
    return largest


def largest_distance(points: Floats, P: Floats, p: Floats, Q: Floats, q: Floats) -> float:
    """Largest distance in the image between points under two projections.

    Args:
        points: (3, V).
        P, p: (3, 3) and (3,): P x + p is the homogeneous pixel of x; its third entry is the depth.
        Q, q: of the other projection.

    Returns:
        Pixels; infinite where a point is not in front of the camera.

    >>> point, K = np.array([[0.0], [0.0], [1.0]]), np.diag([60.0, 60.0, 1.0])
    >>> aside = np.array([6.0, 0.0, 0.0])  # 0.1 m times the focal length
    >>> largest_distance(point, K, np.zeros(3), K, aside)
    6.0
    """
    apart, depth = pinhole_distances(points, P, p, Q, q)
    return float(np.sqrt(apart.max())) if depth.min() > 0 else float("inf")
