"""Where an object is if it stands on the plane on which the other labelled objects stand.

The plane is that of the others: their labels say nothing of their own heights, but where several of
them agree, the object that floats above, or sinks into their plane, or tilts on it is off its
place. A stack, a thing that leans on another one or a hook on the wall stand on no such plane, and
say nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.contours import mesh_problem, object_centre
from std_toolkit.checks.measure.coverage import seen_from_above
from std_toolkit.checks.measure.motion_solver import symmetry_motions
from std_toolkit.checks.result import ObjectCheck, Value
from std_toolkit.geometry import SE3
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
    agree_slope: float = limit(0.015, source="resting faces of labels 1 deg off")
    """the same in parts of the distance between the objects"""
    cone_rad: float = limit(np.radians(50.0), unit="rad", source="cameras 10 to 80 deg above it")
    """largest angle between the normal of a plane and what the cameras take for up"""
    level_rad: float = limit(np.radians(12.0), unit="rad", source="faults up to 10 deg")
    """largest angle between an object and its resting face"""
    reach_m: float = limit(0.02, unit="m", source="faults of labels; stacks are higher")
    """largest height at which an object can stand on the plane"""
    uneven_m: float = limit(0.0005, unit="m", source="world seeds 400 to 519 of setting kinds")
    """deviation of the heights of contacts"""
    level_std_rad: float = limit(np.radians(0.3), unit="rad", source="the same scenes")
    """deviation of the slope of the plane, and of the face on which an object stands"""
    mesh_part: float = limit(0.003, source="the same scenes: sizes of meshes differ by 1 to 3 %")
    """deviation of the height of a foot, in parts of the object's size"""


# Planes that are tried for each object: those on which it stands best.
_MOST_FACES = 3


@dataclass(frozen=True, eq=False)
class Foot:
    """The face on which an object rests best, near its label.

    Attributes:
        contacts: (N, 3) points of the face in the world.
        level: (3,) its upward normal.
        tilt: angle between it and the plane, radians.
        size: of the object, metres.
    """

    contacts: Array
    level: Array
    tilt: float
    size: float

    @staticmethod
    def of(placed: PlacedObject, up: Array) -> Foot:
        """Of an object at its label; `up` is the normal of a plane (3,)."""
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


class Standing:
    """Planes on which labelled objects stand.

    Args:
        placed: objects at their labels, by id.
        cameras: T_world_cam of the frames.
        up: (3,) what is taken for up, roughly.
    """

    def __init__(
        self, placed: Mapping[int, PlacedObject], cameras: Sequence[SE3], up: Array
    ) -> None:
        self._placed = placed
        self._up = up
        # Own object, normal, and the objects that stand on the plane of its face.
        self._planes: list[tuple[int, Array, frozenset[int]]] = []
        limits = StandingCheckSettings.current()
        seen_from = np.array([T.t for T in cameras]).reshape(-1, 3)
        likely = [up, *([seen_from_above(cameras)] if cameras else [])]
        for i, obj in placed.items():
            normals = -(obj.T_frame_obj.R @ obj.solid.resting.down.T).T
            near = np.max([normals @ u for u in likely], axis=0)
            steady = np.where(near >= np.cos(limits.cone_rad), obj.solid.resting.steady, -1.0)
            for k in np.argsort(-steady)[:_MOST_FACES]:
                if steady[k] > 0 and (seen_from @ normals[k] > self._low(i, normals[k])).all():
                    self._planes.append((i, normals[k], self._on(i, normals[k])))

    def has(self, object_id: int) -> bool:
        """Whether an object has a label and a mesh."""
        return object_id in self._placed

    @property
    def up(self) -> Array:
        """(3,) normal of the plane on which most objects stand; what is taken for up without."""
        best = max(self._planes, key=lambda p: (len(p[2]), p[1] @ self._up), default=None)
        if best is None or len(best[2]) < StandingCheckSettings.current().fewest:
            return self._up
        return best[1]

    def value(self, object_id: int, centre: Array, free: Array) -> Value | None:
        """The motion from a label to the plane of the others; None where there is none.

        Args:
            object_id: of the object.
            centre: (3,) of it, in the world.
            free: (N, 6) motions that its symmetry leaves open.
        """
        fewest = StandingCheckSettings.current().fewest
        found = [(on - {object_id}, n) for i, n, on in self._planes if i != object_id]
        others, normal = max(
            found, key=lambda p: (len(p[0]), p[1] @ self._up), default=(frozenset(), self._up)
        )
        if len(others) < fewest:
            return None
        plane = self._fitted(others, normal)
        return _motion(Foot.of(self._placed[object_id], plane.normal), plane, centre, free)

    def _low(self, object_id: int, normal: Array) -> float:
        obj = self._placed[object_id]
        return float((obj.T_frame_obj @ obj.solid.hull @ normal).min())

    def _on(self, own: int, normal: Array) -> frozenset[int]:
        """The objects that stand on the plane of a face of one of them."""
        limits = StandingCheckSettings.current()
        low, there = self._low(own, normal), self._placed[own].T_frame_obj.t
        found = {own}
        for j, obj in self._placed.items():
            away = limits.agree_slope * float(np.linalg.norm(obj.T_frame_obj.t - there))
            if abs(self._low(j, normal) - low) <= limits.agree_m + away:
                _, tilt = obj.solid.resting.nearest(-obj.T_frame_obj.R.T @ normal)
                if tilt <= limits.level_rad:
                    found.add(j)
        return frozenset(found)

    def _fitted(self, chosen: Collection[int], normal: Array) -> _Plane:
        limits = StandingCheckSettings.current()
        feet = [Foot.of(self._placed[i], normal) for i in sorted(chosen)]
        normal = np.mean([f.level for f in feet], axis=0)
        normal /= np.linalg.norm(normal)
        heights = np.array([float((f.contacts @ normal).mean()) for f in feet])
        spread = max(limits.uneven_m, float(np.std(heights)))
        std = float(spread / np.sqrt(len(feet)))
        return _Plane(normal, float(np.median(heights)), std, len(feet))


def standing_of(scene: Scene, objects: Sequence[ObjectCheck], up: Array) -> Standing:
    """The planes of the labelled objects of a scene; `up` (3,) roughly."""
    placed = {}
    for item in objects:
        pose = scene.T_world_obj(item.object)
        if pose is not None and item.is_labelled and mesh_problem(scene, item.model) is None:
            placed[item.object] = PlacedObject(item.name, scene.mesh(item.model), pose)
    frames = scene.registered_frames()
    cameras = [T for f in frames if (T := scene.T_world_cam(f.id)) is not None]
    return Standing(placed, cameras, up)


def with_standing(
    scene: Scene, objects: Sequence[ObjectCheck], planes: Standing
) -> list[ObjectCheck]:
    """The rows with `standing_mm`: the motion from the label to the plane of the other objects."""
    found = []
    for item in objects:
        pose = scene.T_world_obj(item.object)
        value = None
        if pose is not None and planes.has(item.object):
            symmetry = scene.objects.model(item.model).symmetry.symmetry()
            centre = object_centre(scene, item.object)
            value = planes.value(item.object, centre, symmetry_motions(symmetry, pose, centre))
        found.append(item if value is None else item.with_values([value]))
    return found


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
