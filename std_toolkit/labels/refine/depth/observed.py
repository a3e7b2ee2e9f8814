"""Sensor depth around an object, subsampled for trying many poses, and its background plane.

The background plane, such as the table, is fitted to the sensor depth around the object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import depth_maps, plane_fit, se3
from std_toolkit.labels.refine.caster import LayerStore, WorldCaster
from std_toolkit.labels.refine.object_surface import ObjectSurface
from std_toolkit.labels.refine.problem import RefineObject, RefineView

Array = NDArray[np.float64]

# Size of the window around the object in which its background is fitted.
_AROUND_M = 0.08

_MOST_POINTS = 1500

_FEWEST_POINTS = 60

# Standard deviation of a table-top stereo sensor across a surface: a + b z.
_NOISE_M, _NOISE_PER_M = 0.001, 0.002


@dataclass(frozen=True, eq=False)
class ObservedView:
    """The window of one image in which the object may be.

    Attributes:
        view: the image.
        x, y: top-left pixel of the window.
        sensor: (h, w) measured z-depth, 0 = none, metres.
        steady: (h, w) whether measured, and away from depth discontinuities.
        others: (h, w) z-depth of the other objects, inf = none.
        plane: background plane (n, d) in the camera frame, or None.
    """

    view: RefineView
    x: int
    y: int
    sensor: NDArray[np.float32]
    steady: NDArray[np.bool_]
    others: NDArray[np.float32]
    plane: Array | None

    def thinned(self, count: int) -> ObservedPixels:
        """About `count` of its pixels, on a regular grid."""
        h, w = self.sensor.shape
        stride = max(1, round(np.sqrt(h * w / count)))
        v, u = np.mgrid[stride // 2 : h : stride, stride // 2 : w : stride].reshape(2, -1)
        uv = np.stack([u + self.x, v + self.y], axis=-1).astype(np.float64)
        directions = self.view.camera.unproject(uv)
        columns = len(range(stride // 2, w, stride))
        behind = (
            np.full(len(uv), np.inf) if self.plane is None else plane_depth(self.plane, directions)
        )
        return ObservedPixels(
            self.view.T_world_cam,
            uv,
            directions,
            self.sensor[v, u].astype(np.float64),
            self.steady[v, u],
            self.others[v, u].astype(np.float64),
            behind,
            columns,
            partial(self._smooth_color, u, v, 0.5 * stride),
        )

    def _smooth_color(
        self, u: NDArray[np.intp], v: NDArray[np.intp], sigma: float
    ) -> NDArray[np.float32]:
        h, w = self.sensor.shape
        crop = self.view.color[self.y : self.y + h, self.x : self.x + w].astype(np.float32)
        return np.asarray(cv2.GaussianBlur(crop, (0, 0), sigma), dtype=np.float32)[v, u]


@dataclass(frozen=True, eq=False)
class ObservedPixels:
    """N pixels of one view.

    Attributes:
        T_world_cam: camera pose of the view.
        uv: (N, 2) pixels.
        directions: (N, 3) rays with z = 1, camera frame.
        sensor: (N,) z-depth, 0 = none, metres.
        steady: (N,) whether measured, and away from depth discontinuities.
        others: (N,) z-depth of the other objects, inf = none.
        background: (N,) z-depth of the background plane, inf = unknown.
        columns: number of columns of the pixel grid, stored row by row.
        read_color: returns `color`.
    """

    T_world_cam: se3.SE3
    uv: Array
    directions: Array
    sensor: Array
    steady: NDArray[np.bool_]
    others: Array
    background: Array
    columns: int
    read_color: Callable[[], NDArray[np.float32]]

    @cached_property
    def color(self) -> NDArray[np.float32]:
        """(N, 3) float32 RGB, smoothed to the grid's pitch."""
        return self.read_color()


@dataclass(frozen=True, eq=False)
class ObservedRays:
    """The pixels of several views as one set of rays, because each cast has a fixed cost.

    Attributes:
        origins, directions: (N, 3) of the rays in the world; z = 1 in the camera of each.
        sensor, steady, others, background: (N,) as for the pixels.
    """

    origins: Array
    directions: Array
    sensor: Array
    steady: NDArray[np.bool_]
    others: Array
    background: Array

    @staticmethod
    def of(views: Sequence[ObservedPixels]) -> ObservedRays:
        """All pixels of the views, of which there is at least one."""
        return ObservedRays(
            np.concatenate([np.tile(v.T_world_cam.t, (len(v.uv), 1)) for v in views]),
            np.concatenate([v.directions @ v.T_world_cam.R.T for v in views]),
            *(
                np.concatenate([getattr(v, name) for v in views])
                for name in ("sensor", "steady", "others", "background")
            ),
        )

    def only(self, chosen: NDArray[np.bool_]) -> ObservedRays:
        """The selected rays of (N,)."""
        return ObservedRays(*(getattr(self, f.name)[chosen] for f in fields(self)))


def observe(
    views: Sequence[RefineView],
    obj: RefineObject,
    others: Sequence[RefineObject],
    surface: ObjectSurface,
    *,
    reach_m: float,
    background: bool = True,
    layers: LayerStore | None = None,
) -> list[ObservedView]:
    """The windows of the views that have depth and may show the object near its pose.

    Args:
        reach_m: largest distance of the object from its pose.
        background: fit the plane behind the object.
        layers: cached layers of the others, if any.
    """
    caster = WorldCaster(others, [o.T_world_obj for o in others], layers) if others else None
    found = []
    for view in views:
        if view.depth is None:
            continue
        window = _window(view, obj, reach_m + _AROUND_M)
        if window is None:
            continue
        x0, y0, x1, y1 = window
        sensor = view.depth[y0:y1, x0:x1]
        sensor = np.where(np.isfinite(sensor) & (sensor > 0), sensor, 0).astype(np.float32)
        nearest = np.full(sensor.shape, np.inf, np.float32)
        if caster is not None:
            box = x0, y0, x1 - 1, y1 - 1
            nearest = caster.window(view.camera, view.T_world_cam, box)[0].depth
        steady = (sensor > 0) & ~depth_maps.on_depth_step(sensor)
        bare = ObservedView(view, x0, y0, sensor, steady, nearest, None)
        plane = _background(bare, obj, surface) if background else None
        found.append(ObservedView(view, x0, y0, sensor, steady, nearest, plane))
    return found


def _window(
    view: RefineView, obj: RefineObject, margin_m: float
) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 (exclusive) of the sphere around the object, clipped; None out of view."""
    centre = view.T_world_cam.inverse() @ (obj.T_world_obj @ obj.centre)
    z = float(centre[2])
    if z < 0.05:
        return None
    uv = view.camera.project(centre)
    reach = (obj.radius + margin_m) / z * np.array([view.camera.fx, view.camera.fy])
    low = np.maximum(np.floor(uv - reach), 0).astype(int)
    high = np.minimum(np.ceil(uv + reach) + 1, view.camera.size).astype(int)
    if (high - low < 8).any():
        return None
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _background(observed: ObservedView, obj: RefineObject, surface: ObjectSurface) -> Array | None:
    """The plane behind the object at its pose, from the pixels that it does not cover."""
    pixels = observed.thinned(4000)
    T_cam_obj = pixels.T_world_cam.inverse() @ obj.T_world_obj
    covered = np.isfinite(surface.cast(pixels.directions, T_cam_obj).depth)
    free = pixels.steady & ~covered & ~np.isfinite(pixels.others)
    plane = fit_background(pixels.directions[free] * pixels.sensor[free, None])
    if plane is None:
        return None
    # A plane in front of the object is not the background.
    centre = T_cam_obj @ obj.centre
    return plane if plane[:3] @ centre < plane[3] + 0.5 * obj.radius else None


def fit_background(points: NDArray[np.floating], *, share: float = 0.35) -> Array | None:
    """The plane with most inliers: (4,) = (n, d) with n . p = d, |n| = 1 and d > 0.

    Args:
        points: (N, 3) measured around the object, camera frame, metres.
        share: smallest fraction of the points that must be inliers.

    Returns:
        None if there is no such plane.
    """
    p = np.asarray(points, dtype=np.float64)
    if len(p) < _FEWEST_POINTS:
        return None
    p = p[np.linspace(0, len(p) - 1, min(len(p), _MOST_POINTS)).round().astype(int)]
    sigma = _NOISE_M + _NOISE_PER_M * p[:, 2]
    found = plane_fit.find_planes(p, sigma, np.ones(len(p)), count=1, smallest_weight=share)
    if not found:
        return None
    plane = np.append(found[0].normal, -found[0].offset)
    return plane if plane[3] > 0 else -plane


def plane_depth(plane: Array, directions: Array) -> Array:
    """(N,) z-depth of a plane behind rays (N, 3) with z = 1; inf without an intersection."""
    along = directions @ plane[:3]
    return np.where(along > 1e-6, plane[3] / np.maximum(along, 1e-6), np.inf)
