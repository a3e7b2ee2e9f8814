"""Motion of a label in six degrees of freedom by the sensor depth on its object.

Every reading within the visible outline gives one equation: how far the measured surface lies from
that of the label along its normal, and how a small motion of the object moves the label there
(point to plane; Y. Chen and G. Medioni, 1992). Solved for besides are errors that all readings of
the object share: a depth that is too large by one factor, and an image of depth that is shifted
against colour. Readings of one frame err together, as do those of neighbouring frames: the
covariance follows from how frames disagree, and from a part that no number of readings takes away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.array_file import ArrayFile, FiledArray
from std_toolkit.checks.measure.motion import motion_value
from std_toolkit.checks.measure.motion_solver import without_free
from std_toolkit.checks.measure.sensor_depth import SensorDepthSettings, inner_part
from std_toolkit.checks.result import Value
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.camera import pixel_rays
from std_toolkit.labels.refine.edges.uncertainty import disagreement
from std_toolkit.settings import Settings, limit

_LARGEST_SAMPLE = 400
# Translation, rotation, factor of the depth, shift of its image along x and y.
_UNKNOWNS = 9
_REWEIGHTED = 3
_SMALLEST_STD_M = 0.0005


@dataclass(frozen=True, kw_only=True)
class DepthMotionSettings(Settings):
    """How far readings of sensor depth are believed."""

    correlated_px: float = limit(60.0, unit="px", source="windows of matching, and filled holes")
    """readings that have one error in common"""
    factor: float = limit(0.02, source="a D435 that was not calibrated again")
    """deviation of the factor by which depth is too large"""
    shift_px: float = limit(1.0, unit="px", source="depth that is aligned to colour")
    """deviation of the shift of the depth image along an axis"""
    surface_mm: float = limit(
        3.0,
        unit="mm",
        source="ten objects of two RealSense frames; ten of two others judge it: 72 % of the "
        "errors within one deviation, 90 % within two",
    )
    """deviation of a measured surface that looks like a motion, and stays in all frames"""
    patches: float = limit(4.0, source="sides of an object that a camera sees")
    """independent patches of such a surface"""
    facing: float = limit(0.25, source="15 deg, where a pixel sees depths that differ by its width")
    """least sine of the angle between ray and surface of a reading"""
    fewest_frames: int = limit(3, source="one frame or two do not tell how readings err")
    """frames that a motion needs"""


@dataclass(frozen=True, eq=False, slots=True)
class DepthEquations:
    """Readings on one object in one frame, summed up.

    Attributes:
        sums: (10, 10) normal equations: their matrix, their right side as the last column, and the
            number of independent readings as the first of the last row.
    """

    sums: Array | FiledArray

    def filed(self, file: ArrayFile) -> DepthEquations:
        """The same in a file.

        Raises:
            ToolkitError: the disk is full.
        """
        return DepthEquations(file.put(np.asarray(self.sums)))

    def load(self) -> tuple[Array, Array, float]:
        """Matrix (9, 9), right side (9,), and the number of independent readings."""
        sums = np.asarray(self.sums)
        return sums[:_UNKNOWNS, :_UNKNOWNS], sums[:_UNKNOWNS, _UNKNOWNS], float(sums[_UNKNOWNS, 0])


def depth_equations(
    rendered: NDArray[np.floating],
    sensor: NDArray[np.floating],
    mask: NDArray[np.bool_],
    camera: Camera,
    T_world_cam: SE3,
    centre: Array,
) -> DepthEquations | None:
    """The equations of one object in one frame.

    Args:
        rendered, sensor: (H, W) z-depth in metres, 0 = none.
        mask: (H, W) pixels that show the object.
        camera, T_world_cam: the view.
        centre: (3,) of the object in the world, metres.

    Returns:
        None if too few readings lie on the object.
    """
    limits = DepthMotionSettings.current()
    part, inner = inner_part(mask)
    z, measured = rendered[part], sensor[part]
    near = np.abs(measured - z) < SensorDepthSettings.current().tolerance_m
    v, u = np.nonzero(inner & (z > 0) & (measured > 0) & near)
    total = len(v)
    if total < SensorDepthSettings.current().fewest_pixels:
        return None
    if total > _LARGEST_SAMPLE:
        chosen = np.linspace(0, total - 1, _LARGEST_SAMPLE).round().astype(int)
        v, u = v[chosen], u[chosen]
    rays = pixel_rays(camera)[part]

    def point(down: int, right: int) -> Array:
        at = (v + down, u + right)
        return np.asarray(rays[at] * z[at][:, None].astype(np.float64))

    # Neighbours show the object, too: the mask was eroded.
    normals = np.cross(point(1, 0) - point(-1, 0), point(0, 1) - point(0, -1))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    at, ray = point(0, 0), rays[v, u]
    facing = -(normals * ray).sum(axis=1) / np.linalg.norm(ray, axis=1)
    seen = facing > limits.facing
    if total * seen.mean() < SensorDepthSettings.current().fewest_pixels:
        return None
    at, ray, normals = at[seen], ray[seen], normals[seen]
    off = (measured[v, u] - z[v, u])[seen].astype(np.float64) * (normals * ray).sum(axis=1)
    n = normals @ T_world_cam.R.T
    arm = at @ T_world_cam.R.T + T_world_cam.t - centre
    # A reading at pixel u is of the surface at u - shift.
    aside = normals[:, :2] * at[:, 2:] / np.array([camera.fx, camera.fy])
    J = np.concatenate(
        [n, np.cross(arm, n), (normals * at).sum(axis=1, keepdims=True), aside], axis=1
    )
    prior = _prior()
    independent = total * seen.mean() / limits.correlated_px
    weights, scale = np.ones(len(J)), 0.0
    for _ in range(_REWEIGHTED):
        M = (J * weights[:, None]).T @ J
        x0 = np.linalg.solve(M + prior * 1e-6, (J * weights[:, None]).T @ off)
        left = np.abs(off - J @ x0)
        scale = max(1.4826 * float(np.median(left)), _SMALLEST_STD_M)
        weights = 1 / (1 + (left / (2 * scale)) ** 2)
    share = independent / len(J) / scale**2 * weights
    sums = np.zeros((_UNKNOWNS + 1, _UNKNOWNS + 1))
    sums[:_UNKNOWNS, :_UNKNOWNS] = (J * share[:, None]).T @ J
    sums[:_UNKNOWNS, _UNKNOWNS] = (J * share[:, None]).T @ off
    sums[_UNKNOWNS, 0] = share.sum()
    return DepthEquations(sums)


def depth_motion(
    equations: Sequence[DepthEquations],
    free: Array,
    cameras: Sequence[Array],
) -> Value | None:
    """The motion from a label to where sensor depth puts its object; see `ObjectCheck`.

    Args:
        equations: of the frames that show the object well.
        free: (N, 6) motions that its symmetry leaves open.
        cameras: (6, 6) covariance by frame, see `shared_errors.seen_errors`.

    Returns:
        `surface_mm`; None with too few frames.
    """
    limits = DepthMotionSettings.current()
    if len(equations) < limits.fewest_frames:
        return None
    loaded = [e.load() for e in equations]
    information = np.sum([A for A, _, _ in loaded], axis=0)
    pull = np.sum([b for _, b, _ in loaded], axis=0)
    readings = sum(n for _, _, n in loaded)
    prior = _prior()
    for motion in free:
        row = np.append(motion, [0.0, 0.0, 0.0])
        prior = prior + np.outer(row, row) / 1e-6**2
    moved = [A[:, :6] @ C @ A[:6] for (A, _, _), C in zip(loaded, cameras, strict=True)]
    x = np.linalg.solve(information + prior, pull)
    noise = disagreement(
        [(A + C, b - A @ x) for (A, b, _), C in zip(loaded, moved, strict=True)], least=1.0
    )
    # A surface that is measured wrongly in all frames: no more than some patches are independent.
    stays = readings * (limits.surface_mm / 1000) ** 2 / limits.patches
    part = 1 / (noise + stays)
    inverse = np.linalg.inv(part * information + prior)
    x = part * inverse @ pull
    covariance = inverse + part**2 * inverse @ sum(moved) @ inverse
    kept = without_free(free)
    motion, covariance = kept @ x[:6], kept @ covariance[:6, :6] @ kept.T
    return motion_value("surface_mm", "depth", motion, covariance, frames=len(equations))


def _prior() -> Array:
    limits = DepthMotionSettings.current()
    return np.diag(
        1 / np.array([0.03] * 3 + [0.25] * 3 + [limits.factor] + [limits.shift_px] * 2) ** 2
    )
