"""Sensor depth of an RGB-D scene as depth maps of a scan.

A depth sensor measures plain surfaces, which photos alone cannot match. It is believed on opaque,
diffuse objects only: what it reports through glass lies outside the visual hull or on the table and
is left out, as is what other photos contradict (`std_toolkit.scanning.surface.surface`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.geometry.depth_maps import on_depth_step
from std_toolkit.scanning.photos.views import Grid, View, in_threads
from std_toolkit.scanning.surface.depth_maps import DepthMap, object_window
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# As a cost of matching: where photos match well, they count about three times as much.
_COST = 0.3
_CONTRAST = 3.0
# Standard deviation of the smoothing before normals, pixels.
_SMOOTH = 2.0
# Share of the image's width that is left out around objects, where sensors smear depth.
_APART = 0.02


@dataclass(frozen=True, kw_only=True)
class ScanDepthSettings(Settings):
    """Sensor depth that a scan uses."""

    largest_deviation: float = limit(
        0.05,
        source="sensors are wrong in scale by 1 or 2 %; what deviates more has another fault",
    )
    """largest deviation of the depth from the board"""
    outside_voxels: float = limit(2.0, unit="voxels", source=NOT_RECORDED)
    """points further outside of the hull are not of the object"""
    above_table_m: float = limit(
        0.001,
        unit="m",
        source="below, the sensor may look through the object at the table",
    )
    """smallest height above the table"""
    facing: float = limit(0.2, source="sensors are wrong on surfaces seen from more aside")
    """smallest cosine between normal and ray"""
    board_pixels: int = limit(2000, source=NOT_RECORDED)
    """pixels of the board that the factor needs"""


def depth_factor(views: Sequence[View], corners: Array) -> float | None:
    """By what sensor depth is multiplied to agree with the board; None if too little is seen.

    Args:
        views: photos with masks and sensor depth, in the world of the board (table at z = 0).
        corners: (N, 3) of the board, metres.
    """
    limits = ScanDepthSettings.current()
    outline = cv2.convexHull(corners[:, :2].astype(np.float32))[:, 0].astype(np.float64)
    outline = np.column_stack([outline, np.zeros(len(outline))])
    ratios = []
    for view in views:
        if view.sensor is None:
            continue
        uv, _ = view.project(outline)
        if not np.isfinite(uv).all():
            continue
        board = np.zeros(view.sensor.shape, np.uint8)
        cv2.fillConvexPoly(board, np.rint(uv).astype(np.int32), 1)
        reach = 2 * round(_APART * view.camera.width) + 1
        near = cv2.dilate(view.possible.astype(np.uint8), np.ones((reach, reach), np.uint8))
        v, u = np.nonzero((board > 0) & (near == 0) & (view.sensor > 0))
        rays = view.camera.unproject(np.stack([u, v], axis=1).astype(np.float64))
        down = rays @ view.T_world_cam.R[2]
        with np.errstate(divide="ignore"):
            expected = -view.centre[2] / down
        ratios.append(expected / view.sensor[v, u])
    found = np.concatenate(ratios) if ratios else np.zeros(0)
    found = found[np.isfinite(found) & (found > 0)]
    return float(np.median(found)) if len(found) >= limits.board_pixels else None


def sensor_maps(
    views: Sequence[View],
    hull: Floats,
    grid: Grid,
    *,
    factor: float,
    on_table: bool,
    threads: int,
) -> list[DepthMap | None]:
    """Depth maps of the sensor on the object, in the order of the photos; None without any.

    Args:
        views: photos with masks, of which some have sensor depth.
        hull: signed distance to the visual hull on the voxels, metres.
        grid: the voxels.
        factor: on sensor depth; see `depth_factor`.
        on_table: whether the table is at z = 0.
        threads: number of threads.
    """
    return in_threads(
        lambda view: _one(view, hull, grid, factor, on_table=on_table), views, threads=threads
    )


def _one(view: View, hull: Floats, grid: Grid, factor: float, *, on_table: bool) -> DepthMap | None:
    limits = ScanDepthSettings.current()
    window = object_window(view.shown, 2)
    if view.sensor is None or window is None:
        return None
    x0, y0, x1, y1 = window
    depth = (view.sensor[y0:y1, x0:x1] * np.float32(factor)).astype(np.float32)
    good = view.shown[y0:y1, x0:x1] & (depth > 0) & ~on_depth_step(depth)
    normal, smooth = _normals(view, depth, good, (x0, y0))
    good &= smooth
    v, u = np.nonzero(good)
    uv = np.stack([u + x0, v + y0], axis=1).astype(np.float64)
    points = view.T_world_cam @ view.camera.unproject(uv, depth[v, u].astype(np.float64))
    index = np.rint((points - np.asarray(grid.origin)) / grid.step).astype(np.int64)[:, ::-1]
    kept = ((index >= 0) & (index < grid.shape)).all(axis=1)
    kept[kept] = hull[tuple(index[kept].T)] < limits.outside_voxels * grid.step
    if on_table:
        kept &= points[:, 2] > limits.above_table_m
    good[v[~kept], u[~kept]] = False
    if not good.any():
        return None
    depth[~good] = 0
    shape = depth.shape
    return DepthMap(
        x0, y0, depth, normal, np.full(shape, _COST, np.float32),
        np.full(shape, _CONTRAST, np.float32),
    )  # fmt: skip


def _normals(view: View, depth: Floats, good: Mask, corner: tuple[int, int]) -> tuple[Floats, Mask]:
    """Normals (h, w, 3) towards the camera, its frame, and where they are known."""
    limits = ScanDepthSettings.current()
    known = good.astype(np.float32)
    share = cv2.GaussianBlur(known, (0, 0), _SMOOTH)
    mean = cv2.GaussianBlur(depth * known, (0, 0), _SMOOTH) / np.maximum(share, 1e-6)
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    uv = np.stack([u + corner[0], v + corner[1]], axis=-1).reshape(-1, 2).astype(np.float64)
    rays = view.camera.unproject(uv).reshape(*depth.shape, 3)
    points = rays * mean[..., None]
    along_v, along_u = np.gradient(points, axis=(0, 1))
    normal = np.cross(along_v, along_u)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    facing = (normal * rays).sum(axis=-1) / np.linalg.norm(rays, axis=-1)
    normal[facing > 0] *= -1
    return normal.astype(np.float32), (np.abs(facing) > limits.facing) & (share > 0.5)
