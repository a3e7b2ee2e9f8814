"""Gauss-Newton steps of one object's pose on sensor depth, in both directions.

From the model to the sensor: every visible surface point is compared with the depth measured on
its ray (projective association, point to plane). From the sensor to the model: every measured
point that neither the background nor another object explains is compared with the nearest surface
point. This pulls the object laterally towards points above the table, which its own rays cannot do.

The module also measures the final agreement of a pose with the sensor depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.depth.observed import ObservedRays, ObservedView
from std_toolkit.labels.refine.object_surface import ObjectSurface
from std_toolkit.labels.refine.problem import RefineObject
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Depth on grazing surfaces is inaccurate.
_SMALLEST_COSINE = 0.25

# Points closer than this to the surface are compared along its normal, others along the shortest
# distance: at a rim the face normals are not informative.
_NEAR_M = 0.002

# Measured points nearer to the background than this may belong to it.
_STANDS_OUT_M = 0.006

_SMALLEST_STD_M = 0.001

# Neighbouring pixels are correlated: all readings together count as this many.
_INDEPENDENT = 50.0

# Weak prior for directions that depth does not determine: metres, radians.
_PRIOR_M, _PRIOR_RAD = 0.02, 0.15

_PIXELS_PER_VIEW = 20_000


@dataclass(frozen=True, kw_only=True)
class DepthReadingSettings(Settings):
    """When a reading of the sensor agrees with a surface."""

    close_m: float = limit(0.005, unit="m", source=NOT_RECORDED)
    """largest distance along the ray at which a reading agrees"""
    close_share: float = limit(0.01, source=NOT_RECORDED)
    """the same as a fraction of the range; the larger of both counts"""


@dataclass(frozen=True, eq=False)
class DepthResiduals:
    """Linearised residuals about a pose T_world_obj; a step is T_world_obj @ SE3.exp(xi).

    Attributes:
        r: (N,) metres, measured minus model along a direction of the object frame.
        J: (N, 6) derivative of the model by xi along that direction.
        weight: (N,) before robust weighting.
    """

    r: Array
    J: Array
    weight: Array


def depth_residuals(
    surface: ObjectSurface,
    sensor_rays: ObservedRays,
    T_world_obj: SE3,
    *,
    gate_m: float,
    reverse_weight: float,
) -> DepthResiduals:
    """Residuals of all rays.

    Args:
        gate_m: measured points further than this from the surface are ignored.
        reverse_weight: weight of the residuals from the sensor to the model; 0 disables them.
    """
    rays = sensor_rays.directions @ T_world_obj.R
    origins = (sensor_rays.origins - T_world_obj.t) @ T_world_obj.R
    hits = surface.cast_from(sensor_rays.origins, sensor_rays.directions, T_world_obj)
    shown = np.isfinite(hits.depth) & (hits.depth < sensor_rays.others)
    cosine = -np.einsum("ij,ij->i", hits.normal, rays) / np.linalg.norm(rays, axis=1)
    use = shown & sensor_rays.steady & (cosine > _SMALLEST_COSINE)
    use &= np.abs(sensor_rays.sensor - np.where(shown, hits.depth, 0)) < gate_m
    n, ray = hits.normal[use], rays[use]
    r = np.einsum("ij,ij->i", n, ray) * (sensor_rays.sensor[use] - hits.depth[use])
    points = origins[use] + ray * hits.depth[use, None]
    forward = DepthResiduals(r, _derivative(points, n), np.ones(len(n)))
    expected = np.minimum(sensor_rays.others, sensor_rays.background)
    stands_out = (
        sensor_rays.steady & np.isfinite(expected) & (sensor_rays.sensor < expected - _STANDS_OUT_M)
    )
    if reverse_weight <= 0 or not stands_out.any():
        return forward
    measured = origins[stands_out] + rays[stands_out] * sensor_rays.sensor[stands_out, None]
    nearest, normal = surface.closest(measured)
    away = measured - nearest
    distance = np.linalg.norm(away, axis=1)
    near = distance < _NEAR_M
    direction = np.where(near[:, None], normal, away / np.maximum(distance, 1e-9)[:, None])
    use = distance < gate_m
    r = np.einsum("ij,ij->i", direction, away)[use]
    return DepthResiduals(
        np.concatenate([forward.r, r]),
        np.concatenate([forward.J, _derivative(nearest[use], direction[use])]),
        np.concatenate([forward.weight, np.full(len(r), reverse_weight)]),
    )


def _derivative(points: Array, directions: Array) -> Array:
    """(N, 6) of points of the object along directions, by a right perturbation of its pose."""
    return np.hstack([directions, np.cross(points, directions)])


def icp_step(obj: RefineObject, residuals: DepthResiduals, *, spread_m: float) -> Array:
    """The step xi (6,) of the robustly weighted residuals.

    Args:
        spread_m: residuals beyond about this are treated as outliers.
    """
    size = _balance(obj)
    xi = np.zeros(6)
    for _ in range(2):
        A, b = _normal_equations(obj, residuals, xi, spread_m)
        xi = size * np.linalg.solve(A * np.outer(size, size), size * b)
    return np.asarray(xi)


def pose_covariance(obj: RefineObject, residuals: DepthResiduals) -> Array:
    """(6, 6) of a right perturbation, at a pose that needs no further step."""
    size = _balance(obj)
    A, _ = _normal_equations(obj, residuals, np.zeros(6), 0.01)
    return np.asarray(np.linalg.inv(A * np.outer(size, size)) * np.outer(size, size))


def _normal_equations(
    obj: RefineObject, residuals: DepthResiduals, xi: Array, spread_m: float
) -> tuple[Array, Array]:
    """Information (6, 6) and right-hand side (6,), weighted for the residuals after step `xi`."""
    r, J = residuals.r, residuals.J
    left = r - J @ xi
    std = min(max(1.4826 * float(np.median(np.abs(left))), _SMALLEST_STD_M), spread_m)
    w = residuals.weight / (1 + (left / (2 * std)) ** 2) ** 2
    w *= min(1.0, _INDEPENDENT / len(r)) / std**2
    JW = (J * w[:, None]).T
    prior = np.array([_PRIOR_M] * 3 + [_PRIOR_RAD] * 3) ** -2.0
    A = JW @ J + np.diag(prior)
    for axis, offset in obj.symmetry.continuous:
        # A rotation about the axis of symmetry has no visible effect.
        twist = np.concatenate([-np.cross(axis, offset), axis])
        A += 1e8 * np.outer(twist, twist)
    return A, JW @ r


def _balance(obj: RefineObject) -> Array:
    """(6,) scales that make metres and radians comparable."""
    return np.array([1.0] * 3 + [1 / obj.radius] * 3)


def icp(
    surface: ObjectSurface,
    obj: RefineObject,
    sensor_rays: ObservedRays,
    T_world_obj: SE3,
    *,
    gates_m: Sequence[float],
    reverse_weight: float = 0.5,
    settled_m: float = 2e-4,
) -> SE3:
    """Steps with a narrowing gate; ends early at the last gate on convergence."""
    T = T_world_obj
    for k, gate in enumerate(gates_m):
        rows = depth_residuals(surface, sensor_rays, T, gate_m=gate, reverse_weight=reverse_weight)
        if len(rows.r) < 20:
            return T
        xi = icp_step(obj, rows, spread_m=gate / 3)
        shift, turn = float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))
        T = T @ SE3.exp(xi / max(shift / 0.04, turn / 0.35, 1.0))
        last = gate == gates_m[-1]
        if last and shift + turn * obj.radius < settled_m and k > 0:
            break
    return T


@dataclass(frozen=True)
class DepthAgreement:
    """Sensor depth on the visible surface of an object at a pose.

    Attributes:
        median_m: median of |rendered - sensor| depth over all readings on the visible surface,
            metres; nan without readings.
        rms_m: root mean square of the distance across the surface of the readings that agree with
            it, metres; nan without such.
        explained: fraction of the readings within 5 mm, or 1 % of the distance, of the surface.
        measured: fraction of the visible surface that has a reading.
        readings: their number, in pixels of the images.
    """

    median_m: float
    rms_m: float
    explained: float
    measured: float
    readings: int


def measure_depth(
    surface: ObjectSurface,
    observed: Sequence[ObservedView],
    T_world_obj: SE3,
    *,
    depth_factor: float = 1.0,
) -> DepthAgreement:
    """Compare the rendered object with the sensor.

    Args:
        depth_factor: true depth = depth_factor * sensor depth.
    """
    limits = DepthReadingSettings.current()
    shown = 0
    ratio = 0.0
    along: list[NDArray[np.float64]] = []
    across: list[NDArray[np.float64]] = []
    close: list[NDArray[np.bool_]] = []
    for view in observed:
        pixels = view.thinned(_PIXELS_PER_VIEW)
        T_cam_obj = pixels.T_world_cam.inverse() @ T_world_obj
        hits = surface.cast(pixels.directions, T_cam_obj)
        visible = np.isfinite(hits.depth) & (hits.depth < pixels.others)
        read = visible & (pixels.sensor > 0)
        gap = depth_factor * pixels.sensor[read] - hits.depth[read]
        rays = pixels.directions[read] @ T_cam_obj.R
        shown += int(visible.sum())
        ratio = max(ratio, view.sensor.size / max(len(pixels.uv), 1))
        along.append(np.abs(gap))
        across.append(gap * np.einsum("ij,ij->i", rays, hits.normal[read]))
        close.append(
            np.abs(gap) < np.maximum(limits.close_m, limits.close_share * hits.depth[read])
        )
    gaps = np.concatenate(along) if along else np.empty(0)
    if not len(gaps):
        return DepthAgreement(float("nan"), float("nan"), 0.0, 0.0, 0)
    inside = np.concatenate(close)
    normal = np.concatenate(across)[inside]
    return DepthAgreement(
        float(np.median(gaps)),
        float(np.sqrt(np.mean(normal**2))) if len(normal) else float("nan"),
        float(inside.mean()),
        len(gaps) / shown,
        round(len(gaps) * ratio),
    )
