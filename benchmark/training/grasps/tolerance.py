"""How far a grasp may miss its point and still hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def tolerances(
    points: NDArray[np.floating], good: NDArray[np.bool_], most: float
) -> NDArray[np.float32]:
    """(P, ...) metres to the nearest point where the same grasp is not good.

    As published: the farthest distance around the point at which the grasp, shifted there, is
    still robust; it is known at the points alone.

    Args:
        points: (P, 3) metres.
        good: (P, ...) whether a grasp at the point is; the other axes are views, turns, depths.
        most: metres, of those that no point within limits.

    Returns:
        0 where a grasp is not good itself.
    """
    from scipy.spatial import cKDTree

    flat = good.reshape(len(points), -1)
    found = np.zeros(flat.shape, np.float32)
    tree = cKDTree(points)
    for k, near in enumerate(tree.query_ball_point(points, most)):
        # A column that is not good here needs no neighbours.
        columns = np.flatnonzero(flat[k])
        if not len(columns):
            continue
        own = np.asarray(near)
        apart = np.linalg.norm(points[own] - points[k], axis=1)
        order = np.argsort(apart, kind="stable")
        bad = ~flat[own[order]][:, columns]
        first = bad.argmax(axis=0)
        missing = ~bad[first, np.arange(len(columns))]
        found[k, columns] = np.where(missing, most, apart[order][first])
    return found.reshape(good.shape)
