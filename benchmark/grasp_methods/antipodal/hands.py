"""Hands at pairs of contacts: from where they come, how deep they reach, how wide they open."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmark.grasp_methods.antipodal.obstacles import COARSE_M, FINE_M, Obstacles
from benchmark.grasp_methods.antipodal.pairs import Pairs
from benchmark.grasping.collision import hits_plane
from benchmark.grasping.grasp import Grasps
from benchmark.grasping.gripper import Boxes, Gripper

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
    hit: NDArray[np.bool_] = np.asarray(
        obstacles.coarse.count_inside(grasps, palm, margin=COARSE_M / 4).any(axis=1)
    )
    rest = np.flatnonzero(~hit)
    fingers = Boxes(boxes.low[rest, :-1], boxes.high[rest, :-1])
    counts = obstacles.fine.count_inside(grasps[rest], fingers, margin=FINE_M / 8)
    hit[rest] = counts.any(axis=1)
    return hit
