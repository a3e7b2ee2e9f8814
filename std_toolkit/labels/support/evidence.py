"""What the frames of a scene say about the table: points, cameras and placed objects.

A depth sensor that reads too far puts the table too low: by how much, and how to tell.

Every reading of a camera at height h above the table is too deep by the same factor, which moves
the table down by the same share of h. Two objects tell the factor: points of the reconstruction on
the table, which know nothing of the sensor; and, more weakly, cameras at different heights, whose
tables must be one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera, on_depth_step
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support.plane import Plane
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.rendering import maps, placements, point_cloud, raycast
from std_toolkit.rendering.renderer import PlacedMesh, image_window, normalised_rays
from std_toolkit.scene.scene import Frame, Scene

Array = NDArray[np.float64]

_POINTS_PER_FRAME = 6000

# Sensors spread an object's outline, and invent surfaces around glass and metal.
_OUTLINE_MARGIN_PX = 9

# Standard deviation of a table reading at z metres, bias and pose errors included: a + b z^2.
_NOISE_M, _NOISE_PER_M2 = 0.001, 0.003

# Of a reconstructed point at a distance.
_SPARSE_NOISE_M, _SPARSE_NOISE = 0.0005, 0.002

# The table is what the camera is pointed at: spread of the weight, in half images.
_CENTRE = 0.7

# Sensors are off by 2 %; beyond this what was found is something else.
_LARGEST_BIAS = 0.04

_FEWEST_POINTS = 80

_FEWEST_FRAMES = 6

# Of the bias. Camera poses are off too, and in sensors the bias changes with the distance: what
# different heights tell counts only where they agree to a fraction of a millimetre.
_LARGEST_ERROR_BY_POINTS = 0.002

_LARGEST_ERROR_BY_HEIGHTS = 0.0007

# Errors of neighbouring points of a reconstruction are not independent.
_CORRELATED = 5.0


@dataclass(frozen=True, eq=False)
class Points:
    """Points that may lie on the table.

    Attributes:
        xyz: (N, 3) metres, common frame.
        sigma: (N,) standard deviation of each, metres.
        weight: (N,) how much each counts in the search for the largest plane.
        view: (N,) index of the view that saw it, -1 for none in particular.
    """

    xyz: Array
    sigma: Array
    weight: Array
    view: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class View:
    """One frame and where its camera stands in the common frame."""

    frame: Frame
    T_frame_cam: SE3


def placed_objects(scene: Scene, camera_frame: int | None) -> list[PlacedObject]:
    """The labelled objects in the world, or in the camera of a frame."""
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
    """Sensor depth outside the outlines of placed objects; None if there is none."""
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
    """Points of the reconstruction that lie on no placed object, in the world; None if none."""
    found = point_cloud.sparse_points(scene)
    if found is None:
        return None
    xyz = found[0]
    distance = np.linalg.norm(xyz[:, None] - cameras[None, :: max(1, len(cameras) // 8)], axis=2)
    near = distance.min(axis=1)
    keep = near < point_cloud.FARTHEST_M
    for obj in objects:
        local = obj.T_frame_obj.inverse() @ xyz - obj.solid.centre
        # All of the object but what its foot shares with the table.
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
    # The middle of every cell of stride x stride pixels: the same share of every surface.
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
    """Where the table is, relative to where the sensor sees it.

    Attributes:
        shift_m: along the plane's normal, from the sensor's plane to the table.
        depth_factor: sensor depth over true depth.
        uncertainty_m: of the shift, two standard errors.
        note: for people.
    """

    shift_m: float
    depth_factor: float
    uncertainty_m: float
    note: str


def correction_by_points(
    plane: Plane, points: Array, height_m: float, centre: Array, radius_m: float
) -> Correction | None:
    """From reconstructed points (N, 3) near a plane that was found in depth.

    Args:
        height_m: of the cameras above the plane.
        centre, radius_m: the part of the plane that the sensor saw.

    Returns:
        None where too few of the points lie together near the plane.
    """
    reach = np.linalg.norm(plane.project(points) - centre, axis=1)
    distance = plane.signed_distance(points[reach < 1.3 * radius_m])
    distance = np.sort(distance[np.abs(distance) < _LARGEST_BIAS * height_m])
    if len(distance) < _FEWEST_POINTS:
        return None
    # Most of what lies so near the table is the table: the shortest interval with half of the
    # points is where they crowd.
    half = len(distance) // 2
    start = int((distance[half:] - distance[:-half]).argmin())
    shift = float(np.median(distance[start : start + half]))
    spread = 1.4826 * float(np.median(np.abs(distance - shift)))
    crowd = distance[np.abs(distance - shift) < 3 * spread]
    shift = float(np.mean(crowd))
    error = float(np.std(crowd)) / np.sqrt(len(crowd) / _CORRELATED)
    if spread > 0.015 * height_m or error > _LARGEST_ERROR_BY_POINTS * height_m:
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
    """From cameras at different heights, whose tables do not agree.

    Args:
        plane: fitted to the points of all views together.
        centres: (M, 3) of the cameras.

    Returns:
        None where the heights are too alike or the scatter is too large to tell.
    """
    heights, errors = [], []
    for view in np.unique(points.view[inliers]):
        mine = inliers & (points.view == view)
        if mine.sum() >= _FEWEST_POINTS:
            heights.append(float(plane.signed_distance(centres[view])))
            errors.append(float(np.median(plane.signed_distance(points.xyz[mine]))))
    h, e = np.array(heights), np.array(errors)
    if len(h) < _FEWEST_FRAMES or np.ptp(h) < 0.1 * h.mean():
        return None
    # A camera at height h above the sensors' common plane sees it off by
    # e = (1 + b) shift - b h, where b is the relative bias and `shift` leads to the table.
    A = np.stack([np.ones_like(h), -h], axis=1)
    (constant, bias), *_ = np.linalg.lstsq(A, e, rcond=None)
    scatter = float(np.sum((e - A @ [constant, bias]) ** 2)) / (len(h) - 2)
    covariance = scatter * np.linalg.inv(A.T @ A)
    error = float(np.sqrt(covariance[1, 1]))
    if error > _LARGEST_ERROR_BY_HEIGHTS or not 2 * error < abs(bias) < _LARGEST_BIAS:
        return None
    shift = float(constant / (1 + bias))
    factor = float(1 + bias)
    return Correction(
        shift,
        factor,
        2 * float(np.sqrt(covariance[0, 0])) + 0.0005,
        _explanation(shift, factor, "what cameras at different heights see"),
    )


def _explanation(shift_m: float, factor: float, evidence: str) -> str:
    """Note on a correction; what is below the digits that are told is none."""
    millimetres, percent = f"{1000 * shift_m:+.1f}", f"{100 * abs(factor - 1):.1f}"
    if float(millimetres) == 0:
        return f"confirmed by {evidence}"
    sensor = f"the sensor reads {percent} % too {'far' if factor > 1 else 'near'}"
    if float(percent) == 0:
        sensor = "the sensor reads right to 0.1 %"
    return f"moved by {millimetres} mm onto {evidence}: {sensor}"
