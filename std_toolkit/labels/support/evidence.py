"""Points for the search for the table, and correction of the depth bias of the sensor.

A sensor that overestimates depth puts the table too low. The depth of a camera at height h above
the table is too large by a constant factor, which moves the table down by the same fraction of h.
Two sources determine the factor: reconstructed points on the table, which are independent of the
sensor; and, less accurately, cameras at different heights, which must agree on the table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.depth_maps import on_depth_step
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support.plane import Plane
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.rendering import maps, placements, point_cloud, raycast
from std_toolkit.rendering.renderer import PlacedMesh, image_window, normalised_rays
from std_toolkit.scene.scene import Frame, Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

_POINTS_PER_FRAME = 6000

# Sensors blur the outlines of objects, and report false surfaces around glass and metal.
_OUTLINE_MARGIN_PX = 9

# Standard deviation of the depth of the table at z metres, with bias and pose errors: a + b z^2.
_NOISE_M, _NOISE_PER_M2 = 0.001, 0.003

# Standard deviation of a reconstructed point: constant part, and part per metre of distance.
_SPARSE_NOISE_M, _SPARSE_NOISE = 0.0005, 0.002

# The camera points at the table: standard deviation of the weight, in half images.
_CENTRE = 0.7


# Number of points per independent one: errors of neighbouring points are correlated.
_CORRELATED = 5.0


@dataclass(frozen=True, kw_only=True)
class DepthBiasSettings(Settings):
    """When the bias of the sensor is corrected by the table."""

    largest_bias: float = limit(
        0.04,
        source="sensors have a bias of up to 2 %; a larger estimate has another cause",
    )
    """a larger estimate is not used"""
    fewest_points: int = limit(80, source=NOT_RECORDED)
    """points of the table that an estimate needs"""
    fewest_frames: int = limit(6, source=NOT_RECORDED)
    """frames that an estimate from heights needs"""
    largest_error_by_points: float = limit(0.002, source=NOT_RECORDED)
    """largest standard error of the table, relative to the height of the camera"""
    largest_error_by_heights: float = limit(
        0.0007,
        source="camera poses have errors too, and the bias varies with distance",
    )
    """largest standard error of the bias"""


@dataclass(frozen=True, eq=False)
class Points:
    """Points that may lie on the table.

    Attributes:
        xyz: (N, 3) metres, common frame.
        sigma: (N,) standard deviation of each point, metres.
        weight: (N,) weight of each point in the search for the largest plane.
        view: (N,) index of the view of each point, -1 for reconstructed points.
    """

    xyz: Array
    sigma: Array
    weight: Array
    view: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class View:
    """One frame and its camera pose in the common frame."""

    frame: Frame
    T_frame_cam: SE3


def placed_objects(scene: Scene, camera_frame: int | None) -> list[PlacedObject]:
    """Return the labelled objects in the world, or in the camera of a frame."""
    if camera_frame is None:
        poses = {o.id: scene.T_world_obj(o.id) for o in scene.objects.objects}
    else:
        poses = {**placements.frame_placements(scene, camera_frame)}
    return [
        PlacedObject(o.name, scene.mesh(o.model), T)
        for o in scene.objects.objects
        if (T := poses.get(o.id)) is not None
    ]


def depth_points(
    scene: Scene, views: Sequence[View], objects: Sequence[PlacedObject]
) -> Points | None:
    """Return the sensor depth outside the outlines of placed objects; None if there is none."""
    renderer = raycast.RaycastRenderer(threads=0)
    parts = []
    for index, view in enumerate(views):
        depth = scene.read_depth(view.frame)
        if depth is None:
            continue
        camera = scene.camera(view.frame)
        usable = (depth > 0) & (depth < point_cloud.FARTHEST_M) & ~on_depth_step(depth)
        usable &= ~_object_pixels(renderer, camera, view, objects)
        parts.append(_readings(depth, usable, camera, view.T_frame_cam, index))
    return _joined(parts)


def reconstructed_points(
    scene: Scene, cameras: Array, objects: Sequence[PlacedObject]
) -> Points | None:
    """Return the reconstructed points that are not on placed objects, world; None if none."""
    found = point_cloud.sparse_points(scene)
    if found is None:
        return None
    xyz = found[0]
    distance = np.linalg.norm(xyz[:, None] - cameras[None, :: max(1, len(cameras) // 8)], axis=2)
    near = distance.min(axis=1)
    keep = near < point_cloud.FARTHEST_M
    for obj in objects:
        local = obj.T_frame_obj.inverse() @ xyz - obj.solid.centre
        margin = 0.004
        inside = (local > obj.solid.low - margin) & (local < obj.solid.high + margin)
        keep &= ~inside.all(axis=1)
    if not keep.any():
        return None
    sigma = _SPARSE_NOISE_M + _SPARSE_NOISE * near[keep]
    count = int(keep.sum())
    return Points(xyz[keep], sigma, np.ones(count), np.full(count, -1))


def _readings(
    depth: NDArray[np.float32],
    usable: NDArray[np.bool_],
    camera: Camera,
    T_frame_cam: SE3,
    index: int,
) -> Points:
    stride = max(1, int(np.sqrt(np.count_nonzero(usable) / _POINTS_PER_FRAME)))
    # The middle pixel of every stride x stride cell samples all surfaces evenly.
    grid = np.zeros_like(usable)
    grid[stride // 2 :: stride, stride // 2 :: stride] = True
    v, u = np.nonzero(usable & grid)
    z = depth[v, u].astype(np.float64)
    x, y = (np.broadcast_to(a, depth.shape) for a in normalised_rays(camera, image_window(camera)))
    cam = np.stack([x[v, u] * z, y[v, u] * z, z], axis=1)
    off = np.hypot(2 * u / camera.width - 1, 2 * v / camera.height - 1)
    return Points(
        T_frame_cam @ cam,
        _NOISE_M + _NOISE_PER_M2 * z**2,
        np.exp(-0.5 * (off / _CENTRE) ** 2),
        np.full(len(z), index),
    )


def _object_pixels(
    renderer: raycast.RaycastRenderer, camera: Camera, view: View, objects: Sequence[PlacedObject]
) -> NDArray[np.bool_]:
    """(H, W) pixels in and around the outlines of the objects."""
    covered = np.zeros((camera.height, camera.width), dtype=bool)
    if not objects:
        return covered
    T_cam_frame = view.T_frame_cam.inverse()
    placed = [
        PlacedMesh(i + 1, obj.mesh, T_cam_frame @ obj.T_frame_obj) for i, obj in enumerate(objects)
    ]
    for silhouette in maps.compose(renderer, camera, placed).silhouettes:
        covered |= silhouette.image_mask(camera)
    kernel = np.ones((2 * _OUTLINE_MARGIN_PX + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(covered.view(np.uint8), kernel) > 0)


def _joined(parts: Sequence[Points]) -> Points | None:
    if sum(len(p.xyz) for p in parts) == 0:
        return None
    return Points(
        np.concatenate([p.xyz for p in parts]),
        np.concatenate([p.sigma for p in parts]),
        np.concatenate([p.weight for p in parts]),
        np.concatenate([p.view for p in parts]),
    )


@dataclass(frozen=True)
class Correction:
    """Correction of the table plane for the depth bias of the sensor.

    Attributes:
        shift_m: shift along the normal from the measured plane to the table, metres.
        depth_factor: sensor depth over true depth.
        uncertainty_m: two standard errors of the shift, metres.
        note: description of the correction.
    """

    shift_m: float
    depth_factor: float
    uncertainty_m: float
    note: str


def correction_by_points(
    plane: Plane, points: Array, height_m: float, centre: Array, radius_m: float
) -> Correction | None:
    """Estimate the correction from reconstructed points near a plane that was found in depth.

    Args:
        plane: plane found in sensor depth.
        points: (N, 3) reconstructed points, metres.
        height_m: height of the cameras above the plane.
        centre, radius_m: measured part of the plane.

    Returns:
        None if too few of the points are close together near the plane.
    """
    limits = DepthBiasSettings.current()
    reach = np.linalg.norm(plane.project(points) - centre, axis=1)
    distance = plane.signed_distance(points[reach < 1.3 * radius_m])
    distance = np.sort(distance[np.abs(distance) < limits.largest_bias * height_m])
    if len(distance) < limits.fewest_points:
        return None
    # Most of the points so close to the table are on it. The mode of their distances is in the
    # shortest interval with half of the points.
    half = len(distance) // 2
    start = int((distance[half:] - distance[:-half]).argmin())
    shift = float(np.median(distance[start : start + half]))
    spread = 1.4826 * float(np.median(np.abs(distance - shift)))
    crowd = distance[np.abs(distance - shift) < 3 * spread]
    shift = float(np.mean(crowd))
    error = float(np.std(crowd)) / np.sqrt(len(crowd) / _CORRELATED)
    if spread > 0.015 * height_m or error > limits.largest_error_by_points * height_m:
        return None
    factor = height_m / (height_m - shift)
    return Correction(
        shift,
        factor,
        max(2 * error, 0.0005),
        _explanation(shift, factor, "the points of the reconstruction"),
    )


def correction_by_heights(
    plane: Plane, points: Points, inliers: NDArray[np.bool_], centres: Array
) -> Correction | None:
    """Estimate the correction from cameras at different heights, which disagree on the table.

    Args:
        plane: plane fitted to the points of all views.
        points: points from sensor depth.
        inliers: (N,) bool, which points are on the plane.
        centres: (M, 3) camera centres.

    Returns:
        None if the heights are too similar or the scatter is too large.
    """
    limits = DepthBiasSettings.current()
    heights, errors = [], []
    for view in np.unique(points.view[inliers]):
        mine = inliers & (points.view == view)
        if mine.sum() >= limits.fewest_points:
            heights.append(float(plane.signed_distance(centres[view])))
            errors.append(float(np.median(plane.signed_distance(points.xyz[mine]))))
    h, e = np.array(heights), np.array(errors)
    if len(h) < limits.fewest_frames or np.ptp(h) < 0.1 * h.mean():
        return None
    # A camera at height h above the fitted plane measures it with an offset of
    # e = (1 + b) shift - b h, with the relative bias b and the shift to the table.
    A = np.stack([np.ones_like(h), -h], axis=1)
    (constant, bias), *_ = np.linalg.lstsq(A, e, rcond=None)
    scatter = float(np.sum((e - A @ [constant, bias]) ** 2)) / (len(h) - 2)
    covariance = scatter * np.linalg.inv(A.T @ A)
    error = float(np.sqrt(covariance[1, 1]))
    if error > limits.largest_error_by_heights or not 2 * error < abs(bias) < limits.largest_bias:
        return None
    shift = float(constant / (1 + bias))
    factor = float(1 + bias)
    return Correction(
        shift,
        factor,
        2 * float(np.sqrt(covariance[0, 0])) + 0.0005,
        _explanation(shift, factor, "the depth of cameras at different heights"),
    )


def _explanation(shift_m: float, factor: float, evidence: str) -> str:
    """Note on a correction; a shift or bias that rounds to zero is not reported."""
    millimetres, percent = f"{1000 * shift_m:+.1f}", f"{100 * abs(factor - 1):.1f}"
    if float(millimetres) == 0:
        return f"confirmed by {evidence}"
    sensor = f"the sensor reads {percent} % too {'far' if factor > 1 else 'near'}"
    if float(percent) == 0:
        sensor = "the sensor is accurate to 0.1 %"
    return f"moved by {millimetres} mm onto {evidence}: {sensor}"
