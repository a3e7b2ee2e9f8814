"""Compiled test of which of millions of grasps have a point inside the gripper.

Same result as `benchmark.metrics.grasp.collision.Cloud.hit_by`. For so many grasps of one small
object, a loop that ends at the first point inside is fastest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.grasp.gripper import Boxes
from sensors.compiled import compiled


def any_inside(
    points: NDArray[np.floating],
    rotations: NDArray[np.floating],
    translations: NDArray[np.floating],
    boxes: Boxes,
    *,
    margin: float,
) -> NDArray[np.bool_]:
    """(N,) whether any point lies in any box of a grasp.

    Args:
        points: (P, 3) metres.
        rotations: (N, 3, 3) of the grippers.
        translations: (N, 3) metres.
        boxes: of each gripper, in its frame.
        margin: by which they grow on all sides, metres.
    """
    hit = np.zeros(len(rotations), np.bool_)
    if len(points) and len(rotations):
        _search(
            np.ascontiguousarray(points, np.float32),
            np.ascontiguousarray(rotations, np.float32),
            np.ascontiguousarray(translations, np.float32),
            np.ascontiguousarray(boxes.low - margin, np.float32),
            np.ascontiguousarray(boxes.high + margin, np.float32),
            hit,
        )
    return hit


@compiled
def _search(points, rotations, translations, low, high, hit):  # type: ignore[no-untyped-def]
    for n in range(len(rotations)):
        R, t = rotations[n], translations[n]
        x0, x1 = low[n, :, 0].min(), high[n, :, 0].max()
        for p in range(len(points)):
            a = points[p, 0] - t[0]
            b = points[p, 1] - t[1]
            c = points[p, 2] - t[2]
            x = R[0, 0] * a + R[1, 0] * b + R[2, 0] * c
            if x <= x0 or x >= x1:
                continue
            y = R[0, 1] * a + R[1, 1] * b + R[2, 1] * c
            z = R[0, 2] * a + R[1, 2] * b + R[2, 2] * c
            for k in range(low.shape[1]):
                if (
                    low[n, k, 0] < x < high[n, k, 0]
                    and low[n, k, 1] < y < high[n, k, 1]
                    and low[n, k, 2] < z < high[n, k, 2]
                ):
                    hit[n] = True
                    break
            if hit[n]:
                break
