"""Drags: changes of a pose that follow the pointer.

Pure geometry: a pinhole (`ScreenCamera`), points in eye coordinates, screen positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from annotator.views.projection import ScreenCamera
from std_toolkit.geometry import SE3, so3_exp

Array = NDArray[np.float64]

# A ring closer to edge-on than this (sine) is rotated by pointer motion along its tangent.
EDGE_ON = 0.2
NEAREST_M = 0.02
# Largest factor of the distance when sliding an object along the table.
FARTHEST = 3.0


class Drag(Protocol):
    """Change of a pose that follows the pointer."""

    def to(self, xy: ArrayLike) -> SE3:
        """Return T_eye_obj for the pointer at the screen position `xy`."""
        ...


@dataclass(frozen=True, eq=False)
class PlaneDrag:
    """Translation in a plane; the grabbed point stays under the pointer.

    Attributes:
        grabbed: (3,) point of the object, eye coordinates.
        normal: (3,) of the plane, eye coordinates; None for parallel to the image.
    """

    camera: ScreenCamera
    grabbed: Array
    start: SE3
    normal: Array | None = None

    def to(self, xy: ArrayLike) -> SE3:
        ray = self.camera.ray(xy)
        if self.normal is None:
            return SE3(self.start.R, self.start.t + ray * self.grabbed[2] - self.grabbed)
        height, slope = float(self.normal @ self.grabbed), float(self.normal @ ray)
        # Near the plane's horizon and beyond it the point would go to infinity.
        depth = height / slope if height * slope > 0 else np.inf
        shift = ray * min(depth, FARTHEST * self.grabbed[2]) - self.grabbed
        shift -= (shift @ self.normal) * self.normal
        return SE3(self.start.R, self.start.t + shift)


class AxisDrag:
    """Translation along an axis; the grabbed axis point stays under the pointer."""

    def __init__(
        self, camera: ScreenCamera, centre: Array, axis: Array, xy: Array, start: SE3
    ) -> None:
        self._camera, self._centre, self._axis, self._start = camera, centre, axis, start
        self._middle = camera.project(centre)
        # Derivative of the screen position along the axis.
        x, y, z = centre
        direction = np.array(
            [
                camera.fx * (axis[0] * z - x * axis[2]),
                camera.fy * (axis[1] * z - y * axis[2]),
            ]
        )
        self._along = direction / max(float(np.linalg.norm(direction)), 1e-12)
        self._grabbed = self._position(xy)

    def to(self, xy: ArrayLike) -> SE3:
        shift = self._position(np.asarray(xy, dtype=np.float64)) - self._grabbed
        return SE3(self._start.R, self._start.t + shift * self._axis)

    def _position(self, xy: Array) -> float:
        """Return the position along the axis, metres, whose projection is nearest to `xy`."""
        camera, (x, y, z), a = self._camera, self._centre, self._axis
        # Projection of the pointer onto the axis line on the screen, measured along that line.
        wanted = float((xy - self._middle) @ self._along)
        row = np.array([camera.fx * self._along[0], camera.fy * self._along[1]])
        offset = wanted + float(row @ [x, y]) / z
        # row . (p + t a) = offset (z + t a_z), solved for t.
        slope = float(row @ a[:2]) - offset * a[2]
        t = (offset * z - float(row @ [x, y])) / slope if abs(slope) > 1e-12 else np.inf
        # Beyond the vanishing point the line is behind the eye.
        nearest, farthest = -np.inf, np.inf
        if a[2] > 1e-9:
            nearest = (NEAREST_M - z) / a[2]
        elif a[2] < -1e-9:
            farthest = (NEAREST_M - z) / a[2]
        if slope * self._reference_slope <= 0:
            t = np.inf if a[2] > 0 else -np.inf
        limit = 10 * float(z)
        return float(np.clip(t, max(nearest, -limit), min(farthest, limit)))

    @cached_property
    def _reference_slope(self) -> float:
        """Return the slope at the centre; the slope changes its sign at the vanishing point."""
        camera, (x, y, z), a = self._camera, self._centre, self._axis
        row = np.array([camera.fx * self._along[0], camera.fy * self._along[1]])
        return float(row @ a[:2]) - float(row @ [x, y]) / z * float(a[2])


@dataclass(frozen=True, eq=False)
class DepthDrag:
    """Translation along an axis that points at the eye, by `gain` (2,) metres per pixel."""

    gain: Array
    axis: Array
    xy: Array
    start: SE3

    def to(self, xy: ArrayLike) -> SE3:
        shift = float((np.asarray(xy, dtype=np.float64) - self.xy) @ self.gain)
        return SE3(self.start.R, self.start.t + shift * self.axis)


class RingDrag:
    """Rotation about an axis through the centre by the angle that the pointer sweeps."""

    def __init__(
        self,
        camera: ScreenCamera,
        centre: Array,
        axis: Array,
        radius: float,
        xy: Array,
        start: SE3,
    ) -> None:
        self._camera, self._centre, self._axis, self._start = camera, centre, axis, start
        self._u, self._v = plane_basis(axis)
        self._xy = xy
        sight = centre / np.linalg.norm(centre)
        self._edge_on = abs(float(axis @ sight)) < EDGE_ON
        if self._edge_on:
            angles = np.linspace(-np.pi, np.pi, 361)
            near = self._ring_points(angles, radius)
            seen = ((near - centre) @ sight) <= 0
            distance = np.linalg.norm(camera.project(near) - xy, axis=1)
            grabbed = float(angles[np.argmin(np.where(seen, distance, np.inf))])
            ends = camera.project(self._ring_points(np.array([grabbed, grabbed + 1e-4]), radius))
            self._per_radian = (ends[1] - ends[0]) / 1e-4
        else:
            self._grabbed = self._angle(xy)

    def to(self, xy: ArrayLike) -> SE3:
        at = np.asarray(xy, dtype=np.float64)
        if self._edge_on:
            per_radian = self._per_radian
            # At the ends of an edge-on ring the tangent points at the eye.
            angle = float((at - self._xy) @ per_radian) / max(float(per_radian @ per_radian), 1.0)
        else:
            angle = self._angle(at) - self._grabbed
        return turned(self._start, self._centre, self._axis * angle)

    def _angle(self, xy: Array) -> float:
        """Return the angle of the pointer in the ring's plane."""
        ray = self._camera.ray(xy)
        steepness = float(self._axis @ ray)
        if abs(steepness) < 1e-9:
            steepness = 1e-9
        out = ray * (float(self._axis @ self._centre) / steepness) - self._centre
        return float(np.arctan2(out @ self._v, out @ self._u))

    def _ring_points(self, angles: Array, radius: float) -> Array:
        out = np.cos(angles)[:, None] * self._u + np.sin(angles)[:, None] * self._v
        points: Array = self._centre + radius * out
        return points


@dataclass(frozen=True, eq=False)
class TrackballDrag:
    """Rotation about the centre by a virtual trackball of `radius_px`."""

    centre: Array
    radius_px: float
    xy: Array
    start: SE3

    def to(self, xy: ArrayLike) -> SE3:
        dx, dy = (np.asarray(xy, dtype=np.float64) - self.xy) / self.radius_px
        return turned(self.start, self.centre, np.array([dy, -dx, 0.0]))


def turned(T_eye_obj: SE3, centre: Array, rotation: Array) -> SE3:
    """Rotate a pose by a rotation vector (3,) about a point (3,), both in eye coordinates."""
    R = so3_exp(rotation)
    return SE3(R @ T_eye_obj.R, R @ (T_eye_obj.t - centre) + centre)


def plane_basis(axis: Array) -> tuple[Array, Array]:
    """Return unit vectors u, v with u x v = axis."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    return u, np.cross(axis, u)
