"""Points of many frames averaged in the cells of a grid, in bounded memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Cells are numbered with 21 bits an axis: at 1 mm that is a cube of 2 km.
_BITS = 21
_MIDDLE = 1 << (_BITS - 1)
# Frames are collected up to so many rows (56 bytes each) before they are sorted into the grid.
_PENDING_ROWS = 1_000_000


class VoxelGrid:
    """Mean position and colour per occupied cell, and how many frames saw it.

    Args:
        voxel_m: edge of a cell.
        limit: most cells kept; when there are more, cells grow until they fit.
    """

    def __init__(self, voxel_m: float, *, limit: int) -> None:
        self.voxel_m = voxel_m
        self._limit = limit
        self._keys = np.zeros(0, np.int64)
        # Sums of x y z r g b, and the number of points.
        self._sums = np.zeros((0, 7))
        self._pending: list[tuple[NDArray[np.int64], NDArray[np.float64]]] = []

    def __len__(self) -> int:
        self._settle()
        return len(self._keys)

    def add(self, points: NDArray[np.floating], colors: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Add the points (N, 3) metres and colours (N, 3) of one frame.

        Returns:
            (M, 3) the means of the frame's own cells.
        """
        rows = np.empty((len(points), 7))
        rows[:, :3], rows[:, 3:6], rows[:, 6] = points, colors, 1
        keys, sums = _summed(cell_keys(points, self.voxel_m), rows)
        self._pending.append((keys, sums))
        if sum(len(k) for k, _ in self._pending) > _PENDING_ROWS:
            self._settle()
            # Some slack: cells that only one frame saw are dropped in the end.
            while len(self._keys) > 3 * self._limit:
                self._coarsen()
        return sums[:, :3] / sums[:, 6:7]

    def shrink(self) -> None:
        """Let cells grow until there are at most `limit`."""
        while len(self) > self._limit:
            self._coarsen()

    def keep(self, chosen: NDArray[np.bool_]) -> None:
        """Drop the cells that are not chosen (one flag per cell)."""
        self._settle()
        self._keys, self._sums = self._keys[chosen], self._sums[chosen]

    @property
    def points(self) -> NDArray[np.float64]:
        """(N, 3) mean position per cell, metres; in the order of the cells."""
        self._settle()
        return self._sums[:, :3] / self._sums[:, 6:7]

    @property
    def colors(self) -> NDArray[np.uint8]:
        """(N, 3) mean colour per cell."""
        self._settle()
        return (self._sums[:, 3:6] / self._sums[:, 6:7]).round().astype(np.uint8)

    def _settle(self) -> None:
        if self._pending:
            keys, sums = zip((self._keys, self._sums), *self._pending, strict=True)
            self._pending = []
            self._keys, self._sums = _summed(np.concatenate(keys), np.concatenate(sums))

    def _coarsen(self) -> None:
        # The cells hold surfaces: their number falls with the square of the edge.
        self.voxel_m *= float(np.clip(1.05 * np.sqrt(len(self) / self._limit), 1.05, 2.0))
        self._keys, self._sums = _summed(cell_keys(self.points, self.voxel_m), self._sums)


class SeenTwice:
    """Which cells at least two frames saw.

    Args:
        voxel_m: edge of a cell.
    """

    def __init__(self, voxel_m: float) -> None:
        self._voxel_m = voxel_m
        self._once = np.zeros(0, np.int64)
        self._twice = np.zeros(0, np.int64)

    def add(self, points: NDArray[np.floating]) -> None:
        """Points (N, 3) of one frame, metres."""
        keys = np.unique(cell_keys(points, self._voxel_m))
        again = keys[np.isin(keys, self._once, assume_unique=True)]
        self._twice = np.union1d(self._twice, again)
        self._once = np.union1d(self._once, keys)

    def holds(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(N,) whether each point (N, 3) lies in such a cell."""
        return np.isin(cell_keys(points, self._voxel_m), self._twice)


def cell_keys(points: NDArray[np.floating], voxel_m: float) -> NDArray[np.int64]:
    """(N,) number of the cell that holds each point (N, 3)."""
    cell = np.floor(np.asarray(points, dtype=np.float64) / voxel_m).astype(np.int64) + _MIDDLE
    cell = np.clip(cell, 0, (1 << _BITS) - 1)
    return (cell[:, 0] << (2 * _BITS)) | (cell[:, 1] << _BITS) | cell[:, 2]


def _summed(
    keys: NDArray[np.int64], rows: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    unique, inverse = np.unique(keys, return_inverse=True)
    index = inverse.reshape(-1)
    columns = [np.bincount(index, column, minlength=len(unique)) for column in rows.T]
    return unique, np.stack(columns, axis=1)
