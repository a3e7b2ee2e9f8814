"""Boxes against triangles, by separating axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def boxes_meet_triangles(low: Floats, high: Floats, triangles: Floats) -> NDArray[np.bool_]:
    """Whether axis-aligned boxes and triangles have a point in common.

    Two convex bodies are apart exactly if their shadows are on one of these axes: the box's, the
    triangle's normal, and the products of an edge of the one and an edge of the other.

    Args:
        low, high: (B, 3) corners of the boxes.
        triangles: (F, 3, 3) corners in the frame of the boxes.

    Returns:
        (B, F). Touching counts.

    >>> unit = np.zeros((1, 3)), np.ones((1, 3))
    >>> corner = np.array([[[2, 0, 0.5], [0, 2, 0.5], [2, 2, 0.5]]])  # touches the edge x + y = 2
    >>> boxes_meet_triangles(*unit, corner).tolist()
    [[True]]
    >>> boxes_meet_triangles(*unit, corner + [0.1, 0.1, 0]).tolist()
    [[False]]
    """
    half = (high - low)[:, None] / 2
    # Corners seen from the middle of each box: (B, F, 3, 3).
    corners = triangles[None] - ((low + high) / 2)[:, None, None]
    meet = (corners.min(axis=2) <= half).all(axis=-1) & (corners.max(axis=2) >= -half).all(axis=-1)
    edges = np.roll(triangles, -1, axis=1) - triangles
    axes = [np.cross(edges[:, 0], edges[:, 1])]
    axes += [np.cross(unit, edges[:, k]) for unit in np.eye(3) for k in range(3)]
    for axis in axes:
        shadow = np.einsum("bfkj,fj->bfk", corners, axis)
        reach = (half * np.abs(axis)).sum(axis=-1)
        meet &= (shadow.min(axis=2) <= reach) & (shadow.max(axis=2) >= -reach)
    return meet
