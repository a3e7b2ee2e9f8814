"""Where an object is if it stands on the plane on which the other labelled objects stand.

The plane is that of the others: their labels say nothing of their own heights, but where several of
them agree, the object that floats above, or sinks into their plane, or tilts on it is off its
place. A stack, a thing that leans on another one or a hook on the wall stand on no such plane, and
say nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.contours import mesh_problem, object_centre
from std_toolkit.checks.measure.coverage import seen_from_above
from std_toolkit.checks.measure.motion import REPORTED
from std_toolkit.checks.measure.motion_solver import symmetry_motions, without_free
from std_toolkit.checks.result import ObjectCheck, Value
from std_toolkit.geometry import SE3
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.scene import Scene
from std_toolkit.settings import Settings, limit

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
    """deviation of the slope of the face on which an object stands"""
    outlying: float = limit(2.0, unit="deviations", source="usual for robust fits")
    """a foot that differs from the plane by as much has half of its weight"""
    mesh_part: float = limit(0.003, source="the same scenes: sizes of meshes differ by 1 to 3 %")
    """deviation of the height of a foot, in parts of the object's size"""


# Planes that are tried for each object: those on which it stands best.
_MOST_FACES = 3
_ROUNDS = 10


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
        middle: (3,) point of the plane among the objects.
        axes: (2, 3) directions along the plane.
        covariance: (3, 3) of its slopes along the axes, and of its height at the middle.
        count: number of objects.
    """

    normal: Array
    middle: Array
    axes: Array
    covariance: Array
    count: int

    def heights(self, points: Array) -> tuple[Array, Array]:
        """Heights of points (N, 3) above it, and (N, 3) what they change with its parameters."""
        away = points - self.middle
        return away @ self.normal, np.append(away @ self.axes.T, np.ones((len(away), 1)), axis=1)

    @staticmethod
    def under(feet: Sequence[Foot], normal: Array) -> _Plane:
        """Fit the heights and the levels of feet; those that differ from the others weigh less.

        Where they differ by more than their deviations, the plane is known as much worse.
        """
        limits = StandingCheckSettings.current()
        axes = np.linalg.svd(normal[None])[2][1:]
        centres = np.array([f.contacts.mean(axis=0) for f in feet])
        middle = centres.mean(axis=0)
        away = (centres - middle) @ axes.T
        slopes = np.array([-(axes @ f.level) / (normal @ f.level) for f in feet])
        found = np.concatenate([((centres - middle) @ normal)[:, None], slopes], axis=1)
        # (feet, 3 measurements, 3 parameters)
        J = np.zeros((len(feet), 3, 3))
        J[:, 0, :2], J[:, 0, 2], J[:, 1, 0], J[:, 2, 1] = away, 1.0, 1.0, 1.0
        sizes = np.array([f.size for f in feet])
        sigma = np.full((len(feet), 3), limits.level_std_rad)
        sigma[:, 0] = np.hypot(limits.uneven_m, limits.mesh_part * sizes)
        J, found = J / sigma[..., None], found / sigma
        weights = np.ones(len(feet))
        for _ in range(_ROUNDS):
            H = np.einsum("f,fmi,fmj->ij", weights, J, J)
            solved = np.linalg.solve(H, np.einsum("f,fmi,fm->i", weights, J, found))
            square = ((found - J @ solved) ** 2).sum(axis=1)
            weights = 1 / (1 + square / (3 * limits.outlying**2))
        excess = float(weights @ square) / max(3 * float(weights.sum()) - 3, 1.0)
        fitted = normal - axes.T @ solved[:2]
        fitted /= np.linalg.norm(fitted)
        # Slopes are small: the axes turn with the normal.
        along = axes - np.outer(axes @ fitted, fitted)
        return _Plane(
            fitted,
            middle + solved[2] * normal,
            along,
            np.linalg.inv(H) * max(1.0, excess),
            len(feet),
        )


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
        plane = _Plane.under([Foot.of(self._placed[i], normal) for i in sorted(others)], normal)
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
    above, by_plane = plane.heights(foot.contacts)
    if foot.tilt > limits.level_rad or np.abs(above).mean() > limits.reach_m:
        return None
    arm = foot.contacts - centre
    J = np.concatenate([np.tile(normal, (len(arm), 1)), np.cross(arm, normal)], axis=1)
    # Three contacts carry an object, however many corners its face has; the errors of the plane,
    # and that of the height of a mesh's foot, are common to all.
    weight = 3 / len(J) / limits.uneven_m**2
    information = weight * J.T @ J
    gradient = -weight * J.T @ above
    own = limits.mesh_part * foot.size
    inverse = np.linalg.inv(information + np.diag(1 / _OPEN**2))
    motion = inverse @ gradient
    by_heights = weight * inverse @ J.T
    shared, by_plane = by_heights.sum(axis=1), by_heights @ by_plane
    covariance = inverse + own**2 * np.outer(shared, shared)
    covariance += by_plane @ plane.covariance @ by_plane.T
    covariance[3:, 3:] += limits.level_std_rad**2 * (np.eye(3) - np.outer(normal, normal))
    kept = without_free(free)
    motion, covariance = kept @ motion, kept @ covariance @ kept
    motion, covariance = motion * REPORTED, covariance * np.outer(REPORTED, REPORTED)
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
