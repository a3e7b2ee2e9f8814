"""A planner with the true object surfaces: the upper bound for planners.

Its input is points and outward normals of the true surfaces instead of an image.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA, Gripper
from sensors.physics import PhysicalObject
from std_toolkit.geometry.se3 import SE3
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Points per object; about 4 mm apart on a mug.
_POINTS = 2500
_TURNS, _TILTS = 12, (0.0, 0.35)
_TRIED = 50
# Clearance between object and open finger on each side.
_ROOM_M = 0.008
# Depths of the tips beyond the contacts that are tried.
_DEPTHS_M = (0.035, 0.02, 0.01)


@dataclass(frozen=True, kw_only=True)
class OracleSettings(Settings):
    """Grasps that the planner with true surfaces accepts."""

    table_room_m: float = limit(0.004, unit="m", source=NOT_RECORDED)
    """smallest distance of the open fingers from the table"""
    square: float = limit(0.9, source=NOT_RECORDED)
    """smallest cosine between the closing direction and the normal at a contact"""


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface points of an object in the world."""

    points: Array
    normals: Array


def surfaces_of(
    objects: Sequence[PhysicalObject], poses: Sequence[SE3], seed: int = 0
) -> list[Surface]:
    """Sample points on the surfaces of the objects."""
    import trimesh

    found = []
    for obj, T in zip(objects, poses, strict=True):
        mesh = obj.asset.mesh
        points, face = trimesh.sample.sample_surface(mesh, _POINTS, seed=seed)
        normals = np.asarray(mesh.face_normals)[face]
        found.append(Surface(T @ (np.asarray(points) * obj.diagonal_m), normals @ T.R.T))
    return found


def plan_from_surfaces(
    surfaces: Sequence[Surface], *, gripper: Gripper = PANDA, seed: int = 0
) -> Grasps:
    """Plan grasps from above or slightly tilted, in the world frame, best first.

    A few orientations are tried at points of every object. The surfaces between the fingers must be
    nearly perpendicular to the closing direction, and no point of any object may be inside the open
    gripper. Grasps score higher if they are perpendicular to the surface, deep, near the centre of
    the object, and upright.
    """
    rng = np.random.default_rng(seed)
    everything = np.concatenate([s.points for s in surfaces])
    found: list[Grasps] = []
    for index, surface in enumerate(surfaces):
        centre = surface.points.mean(axis=0)
        chosen = rng.choice(len(surface.points), _TRIED, replace=False)
        for turn in range(_TURNS):
            for tilt in _TILTS:
                R = _orientation(np.pi * turn / _TURNS, tilt * (1 if turn % 2 else -1))
                mine, others = surface.points @ R, everything @ R
                normals = surface.normals @ R
                for k in chosen:
                    grasp = _at(k, mine, normals, others, R, centre @ R, gripper, tilt)
                    if grasp is not None:
                        found.append(grasp.replaced(object_ids=np.array([index])))
    return Grasps.concatenated(found).top(1000)


def _orientation(turn: float, tilt: float) -> Array:
    """Approach downwards, tilted about the closing direction."""
    closing = np.array([np.cos(turn), np.sin(turn), 0.0])
    side = np.array([-np.sin(turn), np.cos(turn), 0.0])
    approach = -np.cos(tilt) * np.array([0, 0, 1.0]) + np.sin(tilt) * side
    return np.stack([approach, closing, np.cross(approach, closing)], axis=1)


def _at(
    k: int, mine: Array, normals: Array, others: Array, R: Array, centre: Array,
    gripper: Gripper, tilt: float,
) -> Grasps | None:  # fmt: skip
    """The grasp that closes on the surface at point k, or None. All in the axes of R."""
    limits = OracleSettings.current()
    y, z = mine[k, 1:]
    near = np.abs(mine[:, 2] - z) < gripper.finger_height / 2
    column = near & (np.abs(mine[:, 1] - y) < gripper.max_width / 2)
    if column.sum() < 8:
        return None
    top = mine[column, 0].min()
    for depth in _DEPTHS_M:
        # x points to the table: the tips reach `depth` beyond the highest point.
        tip = top + depth
        band = column & (mine[:, 0] > tip - 0.015) & (mine[:, 0] < tip)
        if band.sum() < 6:
            continue
        ys = mine[band, 1]
        low, high = float(ys.min()), float(ys.max())
        middle, width = (low + high) / 2, high - low + 2 * _ROOM_M
        if width > gripper.max_width:
            continue
        left, right = band & (mine[:, 1] < low + 0.002), band & (mine[:, 1] > high - 0.002)
        square = min(-float(normals[left, 1].mean()), float(normals[right, 1].mean()))
        at = np.array([tip, middle, z])
        lowest = float((R @ at)[2]) - 0.5 * gripper.finger_height * np.sin(tilt)
        if square < limits.square or lowest < limits.table_room_m:
            continue
        boxes = gripper.boxes([width], [0.0])
        local = others - at
        if any(
            ((local > lo) & (local < hi)).all(axis=1).any()
            for lo, hi in zip(boxes.low[0], boxes.high[0], strict=True)
        ):
            continue
        away = float(np.linalg.norm((centre - at)[1:]))
        score = square + 5 * depth - 3 * away - 0.2 * tilt
        return Grasps.make(R[None], (R @ at)[None], widths=width, depths=0.0, scores=score)
    return None
