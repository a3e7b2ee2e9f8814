"""Where an object is if it stands on the plane on which the other labelled objects stand.

The plane is that of the others: their labels say nothing of their own heights, but where several of
them agree, the object that floats above, or sinks into their plane, or tilts on it is off its
place. A stack, a thing that leans on another one or a hook on the wall stand on no such plane, and
say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.contours import mesh_problem, object_centre
from std_toolkit.checks.measure.motion_solver import symmetry_motions
from std_toolkit.checks.result import ObjectCheck, Value
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.scene import Scene
from std_toolkit.settings import Settings, limit

_UNITS = np.array([1000.0] * 3 + [180 / np.pi] * 3)
# What nothing is known of has this deviation: no label is as far off.
_OPEN = np.array([0.03] * 3 + [0.3] * 3)


@dataclass(frozen=True, kw_only=True)
class StandingCheckSettings(Settings):
    """Which objects stand on one plane, and how exactly."""

    fewest: int = limit(2, source="one label that is off would move the plane of another")
    """other objects that must stand on one plane"""
    agree_m: float = limit(0.004, unit="m", source="the limit of a label's translation")
    """largest distance of their lowest points from it"""
    level_rad: float = limit(np.radians(12.0), unit="rad", source="tables are level")
    """largest angle between a plane and the horizon, and between an object and its resting face"""
    reach_m: float = limit(0.02, unit="m", source="faults of labels; stacks are higher")
    """largest height at which an object can stand on the plane"""
    uneven_m: float = limit(0.0005, unit="m", source="world seeds 400 to 519 of setting kinds")
    """deviation of the heights of contacts"""
    level_std_rad: float = limit(np.radians(0.3), unit="rad", source="the same scenes")
    """deviation of the slope of the plane, and of the face on which an object stands"""
    mesh_part: float = limit(0.002, source="the same scenes: sizes of meshes differ by 1 to 3 %")
    """the same in parts of the object's size"""


@dataclass(frozen=True, eq=False)
class Foot:
    """The face on which an object rests best, near its label.

    Attributes:
        contacts: (N, 3) points of the face in the world.
        level: (3,) its upward normal.
        tilt: angle between them, radians.
        size: of the object, metres.
    """

    contacts: Array
    level: Array
    tilt: float
    size: float

    @staticmethod
    def of(placed: PlacedObject, up: Array) -> Foot:
        """Of an object at its label; `up` is a unit vector (3,)."""
        T, solid = placed.T_frame_obj, placed.solid
        down, tilt = solid.resting.nearest(-T.R.T @ up)
        along = solid.hull @ down
        size = float(np.linalg.norm(solid.high - solid.low))
        touching = along >= along.max() - 0.002 * size
        return Foot(T @ solid.hull[touching], -(T.R @ down), float(tilt), size)


@dataclass(frozen=True, eq=False)
class _Plane:
    """The plane on which objects stand.

    Attributes:
        normal: (3,) upwards.
        height: along the normal, metres.
        std: standard deviation of the height.
        count: number of objects.
    """

    normal: Array
    height: float
    std: float
    count: int


def with_standing(scene: Scene, objects: Sequence[ObjectCheck], *, up: Array) -> list[ObjectCheck]:
    """The rows with `standing_mm`: the motion from the label to the plane of the other objects.

    Args:
        scene: with its labels.
        objects: the rows.
        up: (3,) unit vector that points up in the world.
    """
    feet: dict[int, Foot] = {}
    for item in objects:
        pose = scene.T_world_obj(item.object)
        if pose is not None and item.is_labelled and mesh_problem(scene, item.model) is None:
            feet[item.object] = Foot.of(PlacedObject(item.name, scene.mesh(item.model), pose), up)
    found = []
    for item in objects:
        foot, pose = feet.get(item.object), scene.T_world_obj(item.object)
        value = None
        if foot is not None and pose is not None:
            others = [f for i, f in feet.items() if i != item.object]
            symmetry = scene.objects.model(item.model).symmetry.symmetry()
            centre = object_centre(scene, item.object)
            value = standing(foot, others, centre, symmetry_motions(symmetry, pose, centre), up)
        found.append(item if value is None else item.with_values([value]))
    return found


def standing(
    foot: Foot, others: Sequence[Foot], centre: Array, free: Array, up: Array
) -> Value | None:
    """The motion from a label to the plane of other objects; None where there is none.

    Args:
        foot: of the object.
        others: of the others.
        centre: (3,) of the object in the world.
        free: (N, 6) motions that its symmetry leaves open.
        up: (3,) unit vector that points up.
    """
    plane = _plane(others, up)
    return None if plane is None else _motion(foot, plane, centre, free)


def _plane(others: Sequence[Foot], up: Array) -> _Plane | None:
    """The plane of the most objects."""
    limits = StandingCheckSettings.current()
    level = [f for f in others if f.tilt <= limits.level_rad]
    if len(level) < limits.fewest:
        return None
    heights = np.array([float((f.contacts @ up).mean()) for f in level])
    # The most objects on one level; a stack has others.
    near = np.abs(heights[:, None] - heights[None]) <= limits.agree_m
    best = near[int(near.sum(axis=1).argmax())]
    if best.sum() < limits.fewest:
        return None
    chosen = [f for f, taken in zip(level, best, strict=True) if taken]
    normal = np.mean([f.level for f in chosen], axis=0)
    normal /= np.linalg.norm(normal)
    heights = np.array([float((f.contacts @ normal).mean()) for f in chosen])
    spread = max(limits.uneven_m, float(np.std(heights)))
    count = len(chosen)
    return _Plane(normal, float(np.median(heights)), float(spread / np.sqrt(count)), count)


def _motion(foot: Foot, plane: _Plane, centre: Array, free: Array) -> Value | None:
    """The motion that puts the contacts of an object on the plane, and its covariance."""
    limits = StandingCheckSettings.current()
    normal = plane.normal
    above = foot.contacts @ normal - plane.height
    if foot.tilt > limits.level_rad or np.abs(above).mean() > limits.reach_m:
        return None
    arm = foot.contacts - centre
    J = np.concatenate([np.tile(normal, (len(arm), 1)), np.cross(arm, normal)], axis=1)
    # Three contacts carry an object, however many corners its face has; the height of the plane,
    # and that of the foot of a mesh, are common to all.
    weight = 3 / len(J) / limits.uneven_m**2
    information = weight * J.T @ J
    gradient = -weight * J.T @ above
    own = limits.mesh_part * foot.size
    inverse = np.linalg.inv(information + np.diag(1 / _OPEN**2))
    motion = inverse @ gradient
    common = J.mean(axis=0)
    shared = inverse @ (weight * len(J) * common)
    covariance = inverse + np.outer(shared, shared) * (plane.std**2 + own**2)
    covariance[3:, 3:] += limits.level_std_rad**2 * (np.eye(3) - np.outer(normal, normal))
    if len(free):
        kept = np.eye(6) - free.T @ np.linalg.pinv(free @ free.T) @ free
        motion, covariance = kept @ motion, kept @ covariance @ kept
    motion, covariance = motion * _UNITS, covariance * np.outer(_UNITS, _UNITS)
    up_mm = float(np.sqrt(max(float(normal @ covariance[:3, :3] @ normal), 0.0)))
    return Value(
        key="standing_mm",
        value=round(float(motion[:3] @ normal), 2),
        std=round(up_mm, 2),
        unit="mm",
        source="support",
        text=f"on the plane of {plane.count} other objects",
        motion=[round(float(x), 3) for x in motion],
        covariance=[float(f"{x:.6g}") for x in covariance.ravel()],
    )
