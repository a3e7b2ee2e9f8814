"""Gripper poses at contact pairs, without collisions.

Obstacles are the visible points and the space below them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmark.methods.grasp.antipodal.contact_pairs import Pairs
from benchmark.metrics.grasp.collision import Cloud, hits_plane, voxel_means
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import Boxes, Gripper
from std_toolkit.geometry.camera import Camera

FINE_M, COARSE_M = 0.004, 0.01

# Points of one object are nearer to each other than this, at the fine spacing.
_CONNECTED_M = 0.012

# Cells of about 5 mm on a fingertip, along and across.
_PAD_CELLS = 3

# Cells of each box of a finger, along each side, at whose middles depth is looked up.
_CELLS = 4

Floats = NDArray[np.float64]

# Turns of the approach about the closing direction, away from downwards; positive ones make the
# hand come from the side of the camera, where it is known that nothing is in the way.
_TILTS_DEG = (0, 20, -20, 40, 60)

# How far the tips reach beyond the contacts.
_REACHES_M = (0.02, 0.012, 0.006)

# Way that the hand comes from behind, in which nothing must be either.
_WAY_M = 0.1

# Fingers may be as near as this to what they grasp, at the least.
_LEAST_ROOM_M = 0.003

# A hand that points up or level from below the table's edge cannot be there.
_LEAST_DOWN = math.cos(math.radians(80))


@dataclass(frozen=True, eq=False)
class Obstacles:
    """In the table's frame.

    Attributes:
        fine: points about 4 mm apart, for the fingers.
        coarse: about 1 cm apart, for the palm.
        visible: (P, 3) those of `fine` that were seen.
        object_of: (P,) number of the connected piece that each of them belongs to.
        middles: (M, 2) middle of each piece on the table.
    """

    fine: Cloud
    coarse: Cloud
    visible: Floats
    object_of: NDArray[np.int64]
    middles: Floats


def obstacles_of(points: Floats) -> Obstacles:
    """Obstacles of points (P, 3) above the table: they, and all that lies under them.

    A camera sees the near sides and the tops of things alone. What stands on a table mostly goes
    down to it, so a column under each point is taken for solid.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    visible = voxel_means(points, FINE_M)
    filled = voxel_means(np.concatenate([visible, _columns(visible)]), FINE_M)
    if len(visible):
        i, j = cKDTree(visible).query_pairs(_CONNECTED_M, output_type="ndarray").T
        links = coo_array((np.ones(len(i)), (i, j)), shape=(len(visible), len(visible)))
        count, object_of = connected_components(links, directed=False)
    else:
        count, object_of = 0, np.zeros(0, dtype=np.int32)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, object_of, visible[:, :2])
    np.maximum.at(high, object_of, visible[:, :2])
    return Obstacles(
        fine=Cloud(filled),
        coarse=Cloud(voxel_means(filled, COARSE_M)),
        visible=visible,
        object_of=object_of.astype(np.int64),
        middles=(low + high) / 2,
    )


def filled_pads(grasps: Grasps, obstacles: Obstacles, gripper: Gripper) -> Floats:
    """(N,) share of the fingertips' faces before which something was seen between the fingers.

    A grasp of a corner or an edge has little there, and slips or turns.
    """
    share = np.zeros(len(grasps))
    across = gripper.finger_height / _PAD_CELLS
    along = gripper.finger_sections[0][0] / _PAD_CELLS
    half = grasps.widths / 2
    cloud = Cloud(obstacles.visible)
    for row in range(_PAD_CELLS):
        low = np.stack([grasps.depths - (row + 1) * along, -half, np.zeros_like(half)], axis=1)
        high = np.stack([grasps.depths - row * along, half, np.zeros_like(half)], axis=1)
        for column in range(_PAD_CELLS):
            low[:, 2] = -gripper.finger_height / 2 + column * across
            high[:, 2] = low[:, 2] + across
            cell = Boxes(low[:, None].copy(), high[:, None].copy())
            share += cloud.count_inside(grasps, cell)[:, 0] > 0
    return share / _PAD_CELLS**2


def unknown_share(
    grasps: Grasps, gripper: Gripper, depth: NDArray[np.float32], camera: Camera
) -> Floats:
    """(N,) share of the open fingers' volume that the camera sees through pixels without depth.

    What is there is not known: glass and steel leave such holes. What is beyond the image is
    unknown as well.

    Args:
        grasps: in the camera's frame.
        gripper: the hand.
        depth: (h, w) metres, 0 where nothing is known.
        camera: of the depth.
    """
    if not len(grasps):
        return np.zeros(0)
    boxes = gripper.boxes(grasps.widths, grasps.depths)
    boxes = Boxes(boxes.low[:, :-1], boxes.high[:, :-1])  # the palm comes last
    steps = (np.arange(_CELLS) + 0.5) / _CELLS
    cells = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    size = boxes.high - boxes.low
    local = boxes.low[:, :, None] + cells * size[:, :, None]
    points = np.einsum("nij,nbcj->nbci", grasps.rotations, local)
    points += grasps.translations[:, None, None]
    ahead = points[..., 2] > 0
    z = np.where(ahead, points[..., 2], 1.0)
    u = np.rint(camera.fx * points[..., 0] / z + camera.cx)
    v = np.rint(camera.fy * points[..., 1] / z + camera.cy)
    there = ahead & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    row, column = np.where(there, v, 0).astype(np.int64), np.where(there, u, 0).astype(np.int64)
    known = there & (depth[row, column] > 0)
    weight = size.prod(axis=-1)
    return np.asarray(((~known).mean(axis=2) * weight).sum(axis=1) / weight.sum(axis=1))


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


def hands_at(
    pairs: Pairs,
    obstacles: Obstacles,
    gripper: Gripper,
    eye: Floats,
    *,
    room: float,
    table_room: float,
) -> tuple[Grasps, NDArray[np.int64]]:
    """For each pair the first hand that hits nothing, in the table's frame.

    The order of trying is the order of preference: approach downwards before tilted, reaching far
    before reaching just so, wide open before narrow.

    Args:
        pairs: of contacts.
        obstacles: what not to hit.
        gripper: the hand.
        eye: (3,) the camera.
        room: metres between each finger and its contact.
        table_room: metres to stay above the table.

    Returns:
        The grasps, scores 0, and (N,) the pair of each.
    """
    found: list[Grasps] = []
    of_pair: list[NDArray[np.int64]] = []
    left = np.arange(len(pairs))
    coming = replace(gripper, palm=(gripper.palm[0] + _WAY_M, *gripper.palm[1:]))
    for tilt in _TILTS_DEG:
        for reach in _REACHES_M:
            for gap in (room, room / 2):
                if not len(left):
                    break
                grasps, possible = _hands(pairs[left], math.radians(tilt), reach, gap, gripper, eye)
                possible &= ~hits_plane(grasps, gripper, np.eye(4), clearance=table_room)
                tried = np.flatnonzero(possible)
                tried = tried[~_hits(grasps[tried], coming, obstacles)]
                found.append(grasps[tried])
                of_pair.append(left[tried])
                left = np.delete(left, tried)
    return Grasps.concatenated(found), np.concatenate([np.zeros(0, np.int64), *of_pair])


def _hands(
    pairs: Pairs, tilt: float, reach: float, gap: float, gripper: Gripper, eye: Floats
) -> tuple[Grasps, NDArray[np.bool_]]:
    """Hands of one tilt, reach and gap, and which of them there can be."""
    y = pairs.closings
    down = np.array([0.0, 0.0, -1.0]) - y * -y[:, 2:]
    steepness = np.linalg.norm(down, axis=1)
    down /= np.maximum(steepness, 1e-9)[:, None]
    side = np.cross(y, down)
    away = np.einsum("ni,ni->n", side, pairs.middles - eye)
    side = np.where(away[:, None] < 0, -side, side)
    x = math.cos(tilt) * down + math.sin(tilt) * side
    x = np.where(steepness[:, None] > 1e-6, x, np.cross(y, np.eye(3)[np.abs(y).argmin(axis=1)]))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    widths = np.minimum(pairs.widths + 2 * gap, gripper.max_width)
    possible: NDArray[np.bool_] = widths - pairs.widths >= 2 * _LEAST_ROOM_M
    possible &= -x[:, 2] > _LEAST_DOWN
    R = np.stack([x, y, np.cross(x, y)], axis=2)
    return Grasps.make(R, pairs.middles, widths=widths, depths=reach), possible


def _hits(grasps: Grasps, gripper: Gripper, obstacles: Obstacles) -> NDArray[np.bool_]:
    """(N,) hands with an obstacle in them: fingers against the fine points, palm the coarse."""
    boxes = gripper.boxes(grasps.widths, grasps.depths)
    palm = Boxes(boxes.low[:, -1:], boxes.high[:, -1:])
    hit = obstacles.coarse.any_inside(grasps, palm, margin=COARSE_M / 4)
    rest = np.flatnonzero(~hit)
    fingers = Boxes(boxes.low[rest, :-1], boxes.high[rest, :-1])
    hit[rest] = obstacles.fine.any_inside(grasps[rest], fingers, margin=FINE_M / 8)
    return hit
