"""The normal equations of a joint refinement: one pose per object, one scale, one depth factor.

Sensor depth on the visible surface of an object: point-to-plane, robust to holes and edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine.caster import Patch

Array = NDArray[np.float64]

# Stereo depth smears over borders and is inaccurate on grazing surfaces.
_BORDER_PX = 3

_SMALLEST_COSINE = 0.3

Kind = Literal["contour", "depth", "texture"]

# Places of the shared unknowns, counted from the end.
SCALE, FACTOR = 2, 1


@dataclass(frozen=True, eq=False)
class Step:
    """A change of the unknowns that concerns one object.

    Attributes:
        xi: (6,) right perturbation of its pose.
        scale, factor: change of the log scale, and relative change of the depth factor.
    """

    xi: Array
    scale: float
    factor: float


@dataclass(frozen=True, eq=False)
class _Rows:
    """What residuals of any kind have in common; see the kinds."""

    residual: Array
    pose: Array
    scale: Array
    view: int
    points: Array

    def after(self, step: Step) -> Self:
        """The same rows once a small step was made, to first order."""
        return replace(self, residual=self.residual - self.pose @ step.xi - self.scale * step.scale)


@dataclass(frozen=True, eq=False)
class ContourRows(_Rows):
    """Edge residuals of one object in one view with their derivatives.

    Attributes:
        residual: (N,) pixels, found edge minus predicted contour along the outward normal.
        pose: (N, 6) derivative of the predicted position by a right perturbation of the pose.
        scale: (N,) derivative by the logarithm of the camera positions' scale.
        weight: (N,) 0 to 1, clarity of the edge.
        view: index of the view.
        points: (N, 3) of the object, mesh frame.
        spacing: pixels of the contour per sample.
    """

    weight: Array
    spacing: float


@dataclass(frozen=True, eq=False)
class DepthRows(_Rows):
    """Depth residuals of one object in one view with their derivatives.

    Attributes:
        residual: (N,) metres along the surface normal, measured point minus model.
        pose, scale: as in `ContourRows`, of the model along the normal minus the measured point.
        factor: (N,) derivative of the measured point by the depth factor, along the normal.
        view: index of the view.
        points: (N, 3) of the object, mesh frame.
    """

    factor: Array

    def after(self, step: Step) -> Self:
        """The same rows once a small step was made, to first order."""
        after = super().after(step)
        return replace(after, residual=after.residual + self.factor * step.factor)


@dataclass(frozen=True, eq=False)
class TextureRows(_Rows):
    """Residuals of matched points of a texture in one view with their derivatives.

    Attributes:
        residual: (N, 2) pixels, where the view shows the points minus where they are predicted.
        pose: (N, 2, 6) derivative of the predicted pixels by a right perturbation of the pose.
        scale: (N, 2) derivative by the logarithm of the camera positions' scale.
        view: index of the view.
        points: (N, 3) of the object, mesh frame.
    """


@dataclass(frozen=True, eq=False)
class WeightedRows:
    """Residuals of one object in one view, of any kind, with their weights.

    Attributes:
        kind: what was measured.
        index: index of the object.
        view: index of the view.
        residual: (N,) in the unit of the kind.
        jacobian: (N, 6 + K) derivative by the pose and by the shared unknowns.
        shared: offsets of the K shared unknowns from the end of the unknowns.
        information: (N,) weights in 1 / unit^2; their sum counts independent samples.
        points: (N, 3) of the object, mesh frame.
        spacing: pixels of the contour per sample; 1 for other kinds.
    """

    kind: Kind
    index: int
    view: int
    residual: Array
    jacobian: Array
    shared: tuple[int, ...]
    information: Array
    points: Array
    spacing: float = 1.0

    def weighted(self, columns: Array) -> Array:
        """(6 + K, M) weighted sums of residuals (N, M) along the unknowns."""
        return np.asarray(self.jacobian.T @ (columns * self.information[:, None]))

    @property
    def pose_information(self) -> Array:
        """(6, 6) information on the pose."""
        return self.weighted(self.jacobian)[:6, :6]

    @property
    def pose_gradient(self) -> Array:
        """(6,) weighted sum of the residuals along the pose."""
        return self.weighted(self.residual[:, None])[:6, 0]


def contour_rows(
    points_world: Array,
    normals: Array,
    offset: Array,
    weight: Array,
    camera: Camera,
    T_world_cam: SE3,
    T_world_obj: SE3,
    *,
    view: int,
    spacing: float,
) -> ContourRows:
    """Linearise contour samples about the current poses.

    Args:
        points_world: (N, 3) rim points on the object.
        normals: (N, 2) outward in the image.
        offset: (N,) pixels to the found edge.
        view: index of the view.
        spacing: pixels of the contour per sample.
    """
    used = weight > 0
    X_world, n, offset, weight = points_world[used], normals[used], offset[used], weight[used]
    p = T_world_cam.inverse() @ X_world
    # Gradient of n . pixel by the point in the camera frame.
    g = np.stack(
        [
            n[:, 0] * camera.fx / p[:, 2],
            n[:, 1] * camera.fy / p[:, 2],
            -(n[:, 0] * camera.fx * p[:, 0] + n[:, 1] * camera.fy * p[:, 1]) / p[:, 2] ** 2,
        ],
        axis=1,
    )
    g_world = g @ T_world_cam.R.T
    return ContourRows(
        offset,
        _pose_derivative(g_world, X_world, T_world_obj),
        # A larger scale moves the camera away from the world's origin.
        -g_world @ T_world_cam.t,
        view,
        T_world_obj.inverse() @ X_world,
        weight,
        spacing,
    )


def depth_rows(
    samples: DepthSamples, T_world_cam: SE3, T_world_obj: SE3, *, view: int
) -> DepthRows:
    """Linearise depth samples of a view (by index) about the current poses and depth factor."""
    n = samples.normals
    along = (n * samples.directions).sum(axis=1)
    residual = along * (samples.measured - samples.expected)
    return DepthRows(
        residual,
        _pose_derivative(n, samples.points, T_world_obj),
        -n @ T_world_cam.t,
        view,
        T_world_obj.inverse() @ samples.points,
        along * samples.measured,
    )


def texture_rows(
    points: Array,
    pixels: Array,
    camera: Camera,
    T_world_cam: SE3,
    T_world_obj: SE3,
    *,
    view: int,
    scale: float,
) -> TextureRows:
    """Linearise matched points about the current poses.

    Args:
        points: (N, 3) on the mesh, mesh frame.
        pixels: (N, 2) where the camera shows them.
        view: index of the view.
        scale: factor on all pixels, for the image scale of the other measurements.
    """
    X_world = T_world_obj @ points
    p = T_world_cam.inverse() @ X_world
    z, zero = p[:, 2], np.zeros(len(p))
    g = scale * np.stack(
        [
            np.stack([camera.fx / z, zero, -camera.fx * p[:, 0] / z**2], axis=1),
            np.stack([zero, camera.fy / z, -camera.fy * p[:, 1] / z**2], axis=1),
        ],
        axis=1,
    )
    g_world = g @ T_world_cam.R.T
    pose = np.stack(
        [_pose_derivative(g_world[:, k], X_world, T_world_obj) for k in range(2)], axis=1
    )
    residual = scale * (pixels - camera.project(p))
    return TextureRows(residual, pose, -g_world @ T_world_cam.t, view, points)


def _pose_derivative(g_world: Array, X_world: Array, T_world_obj: SE3) -> Array:
    """(N, 6): of g . X_world by xi in T_world_obj @ SE3.exp(xi)."""
    g_obj = g_world @ T_world_obj.R
    X_obj = (X_world - T_world_obj.t) @ T_world_obj.R
    return np.hstack([g_obj, np.cross(X_obj, g_obj)])


class NormalEquations:
    """Sum of weighted squares over 6 * objects + 2 unknowns: poses, log scale, depth factor."""

    def __init__(self, objects: int) -> None:
        self.objects = objects
        size = 6 * objects + 2
        self.A: Array = np.zeros((size, size))
        self.b: Array = np.zeros(size)
        self.SCALE, self.FACTOR = size - SCALE, size - FACTOR

    def add(self, rows: WeightedRows) -> None:
        """Residuals of one object in one view."""
        columns = self.places(rows)
        JW = rows.jacobian * rows.information[:, None]
        self.A[np.ix_(columns, columns)] += rows.jacobian.T @ JW
        self.b[columns] += JW.T @ rows.residual

    def places(self, rows: WeightedRows) -> NDArray[np.intp]:
        """(6 + K,) places of the rows' unknowns."""
        at = 6 * rows.index
        return np.array([*range(at, at + 6), *(len(self.b) - k for k in rows.shared)])

    def add_prior(
        self, at: slice | int, information: Array | float, deviation: Array | float
    ) -> None:
        """A Gaussian prior on unknowns that are now `deviation` away from its mean."""
        if isinstance(at, int):
            at = slice(at, at + 1)
        info = np.atleast_2d(information)
        self.A[at, at] += info
        self.b[at] -= info @ np.atleast_1d(deviation)

    def solve(self, radii: Sequence[float]) -> Array:
        """The step, (6 * objects + 2,); `radii` of the objects balance metres and radians."""
        size = self._size(radii)
        return np.asarray(size * np.linalg.solve(self.A * np.outer(size, size), size * self.b))

    def covariance(self, radii: Sequence[float]) -> Array:
        """Inverse of the information, symmetric."""
        size = self._size(radii)
        inverse = np.linalg.inv(self.A * np.outer(size, size)) * np.outer(size, size)
        return np.asarray((inverse + inverse.T) / 2)

    def _size(self, radii: Sequence[float]) -> Array:
        poses = [x for r in radii for x in (1.0, 1.0, 1.0, 1 / r, 1 / r, 1 / r)]
        return np.array([*poses, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class DepthSamples:
    """Model points and sensor depth on the same rays.

    Attributes:
        points: (N, 3) on the model's surface, world frame.
        normals: (N, 3) of the surface there, world frame, towards the camera.
        directions: (N, 3) of the rays in the world frame, scaled to z = 1 in the camera.
        measured: (N,) sensor z-depth, metres, without the factor.
        expected: (N,) z-depth of the model, metres.
    """

    points: Array
    normals: Array
    directions: Array
    measured: Array
    expected: Array


def sample_depth(
    patch: Patch,
    index: int,
    depth: NDArray[np.float32],
    camera: Camera,
    T_world_cam: SE3,
    *,
    gate_m: float,
    limit: int = 400,
) -> DepthSamples | None:
    """Depth samples on object `index`, at most `limit`, spread evenly; None if too few.

    Args:
        gate_m: samples further than this from the model along the ray are ignored.
    """
    mask = (patch.hits.object == index).astype(np.uint8)
    mask = cv2.erode(mask, np.ones((3, 3), np.uint8), iterations=_BORDER_PX)
    h, w = mask.shape
    sensor = depth[patch.y : patch.y + h, patch.x : patch.x + w]
    good = (mask > 0) & (sensor > 0) & (np.abs(sensor - patch.hits.depth) < gate_m)
    v, u = np.nonzero(good)
    if len(v) < 20:
        return None
    if len(v) > limit:
        keep = np.linspace(0, len(v) - 1, limit).round().astype(int)
        v, u = v[keep], u[keep]
    expected = patch.hits.depth[v, u].astype(np.float64)
    rays = camera.unproject(np.stack([u + patch.x, v + patch.y], axis=-1).astype(np.float64))
    directions = rays @ T_world_cam.R.T
    normals = patch.hits.normal[v, u].astype(np.float64)
    cosine = -(normals * directions).sum(axis=1) / np.linalg.norm(directions, axis=1)
    seen = cosine > _SMALLEST_COSINE
    if seen.sum() < 20:
        return None
    directions, expected = directions[seen], expected[seen]
    return DepthSamples(
        T_world_cam.t + directions * expected[:, None],
        normals[seen],
        directions,
        sensor[v, u].astype(np.float64)[seen],
        expected,
    )
