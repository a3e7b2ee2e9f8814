"""Counts of points in turned boxes, compiled.

The points are sorted into the cells of a grid, so that a box looks at those around it alone.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.grasp.gripper import Boxes
from std_toolkit.compiled import compiled

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]

# Cells of the grid for each point, about; and along an axis at most.
_CELLS_PER_POINT = 1.0
_MOST_CELLS = 128


class PointGrid:
    """Points in the cells of a grid.

    Args:
        points: (P, 3) float64 finite, at least one.
    """

    def __init__(self, points: Floats) -> None:
        self._corner = points.min(axis=0)
        extent = points.max(axis=0) - self._corner
        # A flat cloud has cells, too: no side is below the longest one's share.
        longest = max(float(extent.max()), 1e-9)
        volume = float(np.maximum(extent, longest / _MOST_CELLS).prod())
        side = (volume / (_CELLS_PER_POINT * len(points))) ** (1 / 3)
        self._side = max(side, longest / _MOST_CELLS)
        cells = ((points - self._corner) / self._side).astype(np.int64)
        self._shape = cells.max(axis=0) + 1
        flat = np.ravel_multi_index(tuple(cells.T), tuple(self._shape))
        order = np.argsort(flat, kind="stable")
        self._points = np.ascontiguousarray(points[order])
        self._starts = np.searchsorted(flat[order], np.arange(self._shape.prod() + 1))

    def count(
        self,
        rotations: Floats,
        origins: Floats,
        boxes: Boxes,
        *,
        margin: float = 0.0,
        first_only: bool = False,
    ) -> Numbers:
        """(N, B) int64: how many points lie in each box; its surface is outside.

        Args:
            rotations, origins: (N, 3, 3) and (N, 3) pose of each frame of boxes, metres.
            boxes: (N, B) of them.
            margin: by which they grow on all sides, metres.
            first_only: stop at the first point in any box of a frame.
        """
        counts = np.zeros(boxes.low.shape[:2], np.int64)
        _count(
            self._points,
            self._starts,
            self._corner,
            self._side,
            self._shape,
            np.ascontiguousarray(rotations, np.float64),
            np.ascontiguousarray(origins, np.float64),
            np.ascontiguousarray(boxes.low - margin, np.float64),
            np.ascontiguousarray(boxes.high + margin, np.float64),
            first_only,
            counts,
        )
        return counts


@partial(compiled, error_model="numpy")
def _count(  # type: ignore[no-untyped-def]
    points, starts, corner, side, shape, rotations, origins, low, high, first_only, counts
):
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(low.shape[0]):
        R, t = rotations[n], origins[n]
        for b in range(low.shape[1]):
            # Cells that the box's extent along the axes of the cloud touches.
            empty = False
            for axis in range(3):
                middle, half = t[axis], 0.0
                for k in range(3):
                    middle += R[axis, k] * (low[n, b, k] + high[n, b, k]) / 2
                    half += abs(R[axis, k]) * (high[n, b, k] - low[n, b, k]) / 2
                # A little wider: a point may be rounded into the next cell.
                place, reach = (middle - corner[axis]) / side, half / side + 1e-6
                if not (place + reach >= 0 and place - reach < shape[axis]):
                    empty = True
                    break
                first[axis] = int(max(place - reach, 0.0))
                last[axis] = int(min(place + reach, shape[axis] - 1.0))
            if empty:
                continue
            for i in range(first[0], last[0] + 1):
                for j in range(first[1], last[1] + 1):
                    row = (i * shape[1] + j) * shape[2]
                    for p in range(starts[row + first[2]], starts[row + last[2] + 1]):
                        x, y, z = points[p, 0] - t[0], points[p, 1] - t[1], points[p, 2] - t[2]
                        inside = True
                        for k in range(3):
                            value = x * R[0, k] + y * R[1, k] + z * R[2, k]
                            if not (low[n, b, k] < value < high[n, b, k]):
                                inside = False
                                break
                        if inside:
                            counts[n, b] += 1
                            if first_only:
                                break
                    if first_only and counts[n, b]:
                        break
                if first_only and counts[n, b]:
                    break
            if first_only and counts[n, b]:
                break
