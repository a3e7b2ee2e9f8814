"""What a hand must not run into: what is seen, and what must be beneath it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.grasping.collision import Cloud, voxel_means
from benchmark.grasping.grasp import Grasps
from benchmark.grasping.gripper import Boxes, Gripper

Floats = NDArray[np.float64]

FINE_M, COARSE_M = 0.004, 0.01
# Points of one object are nearer to each other than this, at the fine spacing.
_CONNECTED_M = 0.012
# Cells of about 5 mm on a fingertip, along and across.
_PAD_CELLS = 3


@dataclass(frozen=True, eq=False)
class Obstacles:
    """In the table's frame.

    Attributes:
        fine: points about 4 mm apart, for the fingers.
        coarse: about 1 cm apart, for the palm.
        seen: (P, 3) those of `fine` that were seen.
        object_of: (P,) number of the connected piece that each of them belongs to.
        middles: (M, 2) middle of each piece on the table.
        tops: (M,) height of each piece.
    """

    fine: Cloud
    coarse: Cloud
    seen: Floats
    object_of: NDArray[np.int64]
    middles: Floats
    tops: Floats


def obstacles_of(points: Floats) -> Obstacles:
    """Obstacles of points (P, 3) above the table: they, and all that lies under them.

    A camera sees the near sides and the tops of things alone. What stands on a table mostly goes
    down to it, so a column under each point is taken for solid.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    seen = voxel_means(points, FINE_M)
    filled = voxel_means(np.concatenate([seen, _columns(seen)]), FINE_M)
    if len(seen):
        i, j = cKDTree(seen).query_pairs(_CONNECTED_M, output_type="ndarray").T
        links = coo_array((np.ones(len(i)), (i, j)), shape=(len(seen), len(seen)))
        count, object_of = connected_components(links, directed=False)
    else:
        count, object_of = 0, np.zeros(0, dtype=np.int32)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, object_of, seen)
    np.maximum.at(high, object_of, seen)
    return Obstacles(
        fine=Cloud(filled),
        coarse=Cloud(voxel_means(filled, COARSE_M)),
        seen=seen,
        object_of=object_of.astype(np.int64),
        middles=(low[:, :2] + high[:, :2]) / 2,
        tops=high[:, 2],
    )


def filled_pads(grasps: Grasps, obstacles: Obstacles, gripper: Gripper) -> Floats:
    """(N,) share of the fingertips' faces before which something was seen between the fingers.

    A grasp of a corner or an edge has little there, and slips or turns.
    """
    share = np.zeros(len(grasps))
    across = gripper.finger_height / _PAD_CELLS
    along = gripper.finger_sections[0][0] / _PAD_CELLS
    half = grasps.widths / 2
    cloud = Cloud(obstacles.seen)
    for row in range(_PAD_CELLS):
        low = np.stack([grasps.depths - (row + 1) * along, -half, np.zeros_like(half)], axis=1)
        high = np.stack([grasps.depths - row * along, half, np.zeros_like(half)], axis=1)
        for column in range(_PAD_CELLS):
            low[:, 2] = -gripper.finger_height / 2 + column * across
            high[:, 2] = low[:, 2] + across
            cell = Boxes(low[:, None].copy(), high[:, None].copy())
            share += cloud.count_inside(grasps, cell)[:, 0] > 0
    return share / _PAD_CELLS**2


def _columns(points: Floats) -> Floats:
    """Points under each point, down to the table."""
    step = 1.5 * FINE_M
    below = np.floor(points[:, 2] / step).astype(np.int64)
    which = np.repeat(np.arange(len(points)), below)
    first = np.repeat(np.cumsum(below) - below, below)
    down = np.arange(len(which)) - first + 1
    columns = points[which].copy()
    columns[:, 2] -= step * down
    return columns[columns[:, 2] > 0]
