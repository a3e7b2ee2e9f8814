"""Symmetries of a mesh: turns after which its surface, and its surface and colours, are the same.

The surface is turned about candidate axes, moved until it lies on itself as well as it can, and
its distance from itself is compared with a tolerance that follows from the error of the mesh.
The result is a rotation group: turns about one axis, with or without half turns across it, the
turns of a cube, or those of a sphere. The groups of other regular solids are not searched; a part
of their turns is found.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.geometry.colored_points import FOLDS, GENERIC, ColoredPoints
from std_toolkit.geometry.mesh import surface_error
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import SE3, rotation_angle, so3_exp, so3_log
from std_toolkit.geometry.surface_colors import SurfaceColors
from std_toolkit.geometry.symmetry import Symmetry, closed_group
from std_toolkit.geometry.turned_surface import (
    SAME_AXIS,
    align_turn,
    axes_to_try,
    spread_points,
    turn_about,
)

if TYPE_CHECKING:
    import trimesh


# Points whose colours are compared; every third of them is compared by distance, and every
# fifteenth in a first look.
_POINTS = 4500
_STEPS = 15

# Tolerance in errors of the mesh (two surfaces are compared), and its least value in parts of the
# edge of a cube as large as the bounding box: for a mesh whose error is known, and for one whose
# error is unknown. A mesh does not tell how far it is warped: scans of boxes deviate by 2 to 4 %.
_ERRORS, _LEAST_KNOWN, _LEAST = 2.0, 0.01, 0.04

# Nineteen points of twenty are within the tolerance, and all within this factor of it.
_FARTHEST = 4.0

# A first look rejects turns whose nine nearest points of ten are farther, in parts of the diagonal,
# and after a rough alignment in tolerances.
_HOPELESS, _PROMISING = 0.15, 3.0


# Refined axes nearer than this to a mesh axis are the mesh axis if it fits as well.
_NICE = np.deg2rad(2)

_STEPS_OF_A_TURN = 12


@dataclass(frozen=True)
class CheckedTurn:
    """A turn that was compared with the surface.

    Attributes:
        turn: T_obj_turned.
        distance_m: 95th percentile of the distance between the turned surface and the surface.
        farthest_m: its largest value.
        other_colors: part of the surface whose colours differ after the turn; 0 without colours.
        fits: whether both distances are within the tolerance.
    """

    turn: SE3
    distance_m: float
    farthest_m: float
    other_colors: float
    fits: bool


@dataclass(frozen=True)
class DetectedSymmetry:
    """Symmetries of a mesh, in its frame and in metres.

    Attributes:
        shape: of its surface.
        appearance: of its surface and its colours; the part of `shape` that the colours keep.
        tolerance_m: distance within which nineteen of twenty points of a turned surface lie.
        checked: turns of `shape` with their measurements; steps of a turn for continuous ones.
    """

    shape: Symmetry
    appearance: Symmetry
    tolerance_m: float
    checked: tuple[CheckedTurn, ...] = ()


def detect_symmetry(mesh: trimesh.Trimesh, *, error_m: float | None = None) -> DetectedSymmetry:
    """Find the turns after which a mesh is the same, by its shape and by its look.

    Args:
        mesh: vertices in metres, with or without colours; it need not be closed.
        error_m: 95th percentile of the mesh's deviation from the object, metres, where it is
            known; None estimates what shows in the mesh itself (facets, roughness) and allows for
            a warp of some percent of the size.

    Returns:
        Both answers; without colours they are equal.
    """
    search = _Search(mesh, error_m)
    shape = search.shape()
    checked = tuple(search.check(T) for T in shape.transforms(_STEPS_OF_A_TURN)[1:])
    return DetectedSymmetry(shape, search.appearance(shape), search.tolerance, checked)


def check_symmetry(mesh: trimesh.Trimesh, symmetry: Symmetry) -> CheckedTurn | None:
    """The turn of a declared symmetry that fits a mesh worst; None if nothing is declared."""
    search = _Search(mesh, None)
    turns = [search.check(T) for T in symmetry.transforms(_STEPS_OF_A_TURN)[1:]]
    return max(turns, key=lambda turn: turn.distance_m, default=None)


@dataclass(frozen=True)
class _Axis:
    """A line about which the mesh repeats `order` times per turn; 0: at any angle."""

    direction: Array
    point: Array
    order: int
    distance: float

    def turn(self, angle: float) -> SE3:
        return turn_about(self.point, so3_exp(self.direction * angle))


class _Search:
    """One mesh, its points and its acceleration structure."""

    def __init__(self, mesh: trimesh.Trimesh, error_m: float | None) -> None:
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        faces = np.asarray(mesh.faces)
        used = vertices[np.unique(faces)]
        self._diagonal = float(np.linalg.norm(np.ptp(used, axis=0)))
        error = surface_error(mesh) if error_m is None else error_m
        least = _LEAST if error_m is None else _LEAST_KNOWN
        self._origin = (used.min(axis=0) + used.max(axis=0)) / 2
        self._caster = RayCaster(vertices - self._origin, faces)
        self._all, face, weights = spread_points(vertices, faces, _POINTS)
        self._points = self._all[::3]
        self._centre = self._points.mean(axis=0)
        self.tolerance = max(_ERRORS * error, least * _cube_edge(used - self._centre))
        self._colors = None
        colors = SurfaceColors.from_mesh(mesh)
        if colors is not None:
            corners = vertices[faces[face]]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            self._colors = ColoredPoints(
                self._all,
                normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12),
                colors.at(face, weights),
                self._diagonal,
            )

    def _closest(self, points: Array) -> tuple[Array, Array]:
        nearest, normal = self._caster.closest(points - self._origin)
        return nearest.astype(np.float64) + self._origin, normal.astype(np.float64)

    def _distances(self, turn: SE3) -> Array:
        moved = (turn @ self._points, turn.inverse() @ self._points)
        return np.concatenate([self._caster.distance(p - self._origin) for p in moved])

    def _fits(self, turn: SE3) -> bool:
        return self._within(self._distances(turn))

    def _within(self, distances: Array) -> bool:
        return bool(
            np.percentile(distances, 95) <= self.tolerance
            and distances.max() <= _FARTHEST * self.tolerance
        )

    def check(self, turn: SE3) -> CheckedTurn:
        """Measure one turn."""
        distances = self._distances(turn)
        return CheckedTurn(
            turn,
            float(np.percentile(distances, 95)),
            float(distances.max()),
            0.0 if self._colors is None else self._colors.other_share(turn),
            self._within(distances),
        )

    def shape(self) -> Symmetry:
        """The rotation group of the surface."""
        axes: list[_Axis] = []
        for basis, _ in axes_to_try(self._points):
            for direction in basis:
                if not any(_angle_between(direction, a.direction) < SAME_AXIS for a in axes):
                    found = self._about(direction)
                    if found is not None:
                        axes.append(found)
        if not axes:
            return Symmetry()
        main = min(axes, key=lambda a: (a.order != 0, -a.order, a.distance))
        others = [a for a in axes if a is not main]
        if main.order == 0 and any(a.order == 0 for a in others):
            centre = self._origin
            return Symmetry(
                continuous=tuple((_triple(e), _triple(centre)) for e in np.eye(3)[[0, 2]])
            )
        across = self._across(main)
        if across is None:
            return _symmetry(main, ())
        # The turns across fix the height of the centre along the main axis.
        height = float((across.point - main.point) @ main.direction)
        centre = main.point + height * main.direction
        main = _Axis(main.direction, centre, main.order, main.distance)
        order, direction = 2, across.direction
        if main.order == 4:
            # The half turns of a cube across an axis are about faces and about edges.
            for angle in (0.0, np.pi / 4):
                tried = so3_exp(main.direction * angle) @ across.direction
                quarter = turn_about(centre, so3_exp(tried * np.pi / 2))
                if self._fits(quarter):
                    order, direction = 4, tried
        return _symmetry(main, (_Axis(direction, centre, order, across.distance),))

    def _about(self, direction: Array) -> _Axis | None:
        """The axis near a direction with its order."""
        generic = self._refined(direction, GENERIC[2])
        if generic is not None and all(self._fits(generic.turn(a)) for a in GENERIC):
            return self._nice(generic, 0, GENERIC)
        for order in FOLDS:
            axis = self._refined(direction, 2 * np.pi / order)
            if axis is None:
                continue
            turns = [2 * np.pi * k / order for k in range(1, order // 2 + 1)]
            if all(self._fits(axis.turn(a)) for a in turns):
                return self._nice(axis, order, turns)
        return None

    def _across(self, main: _Axis) -> _Axis | None:
        """The best half turn about an axis across the main one."""
        first = _perpendicular(np.eye(3)[int(np.argmin(np.abs(main.direction)))], main.direction)
        span = np.pi / main.order if main.order else np.deg2rad(1)
        best: _Axis | None = None
        for angle in np.arange(0, span, np.deg2rad(7.5)):
            direction = so3_exp(main.direction * angle) @ first
            axis = self._refined(direction, np.pi)
            if axis is None:
                continue
            exact = _perpendicular(axis.direction, main.direction)
            axis = self._nice(_Axis(exact, axis.point, 2, axis.distance), 2, (np.pi,))
            exact = _perpendicular(axis.direction, main.direction)
            if not self._fits(turn_about(axis.point, so3_exp(exact * np.pi))):
                continue
            if best is None or axis.distance < best.distance:
                best = _Axis(exact, axis.point, 2, axis.distance)
        return best

    def _refined(self, direction: Array, angle: float) -> _Axis | None:
        """The axis near a direction about which the mesh turns into itself by an angle."""
        turn = turn_about(self._centre, so3_exp(direction * angle))
        stages = (
            (self._points[::5], _HOPELESS * self._diagonal),
            (self._points, _PROMISING * self.tolerance),
        )
        for points, limit in stages:
            rough = self._caster.distance(turn @ points[::2] - self._origin)
            if np.percentile(rough, 90) > limit:
                return None
            turn = align_turn(
                turn,
                points,
                self._closest,
                centre=self._origin,
                radius=self._diagonal / 2,
                steps=_STEPS // 2,
            )
        axis = so3_log(turn.R)
        if not np.isfinite(axis).all() or np.linalg.norm(axis) < angle - SAME_AXIS:
            return None
        axis /= np.linalg.norm(axis)
        axis = axis if axis @ direction > 0 else -axis
        if _angle_between(axis, direction) > SAME_AXIS:
            return None
        if rotation_angle(turn.R.T @ so3_exp(axis * angle)) > SAME_AXIS:
            return None
        across = np.linalg.lstsq(np.eye(3) - turn.R, turn.t - axis * (axis @ turn.t), rcond=None)[0]
        point = across + axis * (axis @ (self._centre - across))
        found = _Axis(axis, point, 0, 0.0)
        distance = float(np.percentile(self._distances(found.turn(angle)), 95))
        return _Axis(axis, point, 0, distance)

    def _nice(self, axis: _Axis, order: int, angles: Iterable[float]) -> _Axis:
        """The axis along a mesh axis if that fits about as well."""
        nearest = np.eye(3)[int(np.argmax(np.abs(axis.direction)))]
        if axis.direction @ nearest < 0:
            axis = _Axis(-axis.direction, axis.point, order, axis.distance)
        axis = _Axis(axis.direction, axis.point, order, axis.distance)
        if _angle_between(axis.direction, nearest) > _NICE:
            return axis
        along = _Axis(nearest, axis.point, order, axis.distance)
        worst = [
            max(float(np.percentile(self._distances(a.turn(x)), 95)) for x in angles)
            for a in (along, axis)
        ]
        if worst[0] <= max(1.1 * worst[1], 0.25 * self.tolerance):
            return _Axis(nearest, axis.point, order, worst[0])
        return axis

    def appearance(self, shape: Symmetry) -> Symmetry:
        """The part of a shape's symmetries that the colours keep."""
        return shape if self._colors is None else self._colors.kept(shape)


def _symmetry(main: _Axis, others: Sequence[_Axis]) -> Symmetry:
    turns = [a.turn(2 * np.pi / a.order) for a in others]
    if main.order == 0:
        point = main.point - main.direction * (main.direction @ main.point)
        return Symmetry(
            tuple(tuple(T.flat()) for T in turns), ((_triple(main.direction), _triple(point)),)
        )
    generators = [main.turn(2 * np.pi / main.order), *turns]
    return Symmetry(tuple(tuple(T.flat()) for T in closed_group(generators)[1:]))


def _cube_edge(points: Array) -> float:
    """Edge of a cube of the volume of the points' box along their principal axes."""
    _, _, axes = np.linalg.svd(points, full_matrices=False)
    return float(np.cbrt(np.prod(np.ptp(points @ axes.T, axis=0))))


def _angle_between(a: Array, b: Array) -> float:
    """Angle of two lines, radians."""
    return float(np.arccos(np.clip(abs(a @ b), 0, 1)))


def _perpendicular(direction: Array, axis: Array) -> Array:
    across = direction - (direction @ axis) * axis
    return np.asarray(across / np.linalg.norm(across))


def _triple(v: Array) -> tuple[float, float, float]:
    x, y, z = (float(c) + 0.0 for c in v)
    return x, y, z
