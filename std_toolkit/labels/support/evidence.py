"""What the frames of a scene say about the table: points, cameras and placed objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.depth import on_depth_step
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support.cloud import FARTHEST_M, sparse_points
from std_toolkit.labels.support.solid import PlacedThing
from std_toolkit.rendering.maps import compose
from std_toolkit.rendering.placements import frame_placements
from std_toolkit.rendering.protocol import PlacedMesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.windows import image_window, normalised_rays
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


def placed_things(scene: Scene, camera_frame: int | None) -> list[PlacedThing]:
    """The labelled objects in the world, or in the camera of a frame."""
    if camera_frame is None:
        poses = {o.id: scene.T_world_obj(o.id) for o in scene.objects.objects}
    else:
        poses = {**frame_placements(scene, camera_frame)}
    return [
        PlacedThing(o.name, scene.mesh(o.model), T)
        for o in scene.objects.objects
        if (T := poses.get(o.id)) is not None
    ]


def depth_points(
    scene: Scene, views: Sequence[View], things: Sequence[PlacedThing]
) -> Points | None:
    """Sensor depth outside the outlines of placed objects; None if there is none."""
    renderer = RaycastRenderer(threads=0)
    parts = []
    for index, view in enumerate(views):
        depth = scene.read_depth(view.frame)
        if depth is None:
            continue
        camera = scene.camera(view.frame)
        usable = (depth > 0) & (depth < FARTHEST_M) & ~on_depth_step(depth)
        usable &= ~_object_pixels(renderer, camera, view, things)
        parts.append(_readings(depth, usable, camera, view.T_frame_cam, index))
    return _joined(parts)


def reconstructed_points(
    scene: Scene, cameras: Array, things: Sequence[PlacedThing]
) -> Points | None:
    """Points of the reconstruction that lie on no placed object, in the world; None if none."""
    found = sparse_points(scene)
    if found is None:
        return None
    xyz = found[0]
    distance = np.linalg.norm(xyz[:, None] - cameras[None, :: max(1, len(cameras) // 8)], axis=2)
    near = distance.min(axis=1)
    keep = near < FARTHEST_M
    for thing in things:
        local = thing.T_frame_obj.inverse() @ xyz - thing.solid.centre
        # All of the object but what its foot shares with the table.
        margin = 0.004
        inside = (local > thing.solid.low - margin) & (local < thing.solid.high + margin)
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
    renderer: RaycastRenderer, camera: Camera, view: View, things: Sequence[PlacedThing]
) -> NDArray[np.bool_]:
    """(H, W) pixels in and around the outlines of the objects."""
    covered = np.zeros((camera.height, camera.width), dtype=bool)
    if not things:
        return covered
    T_cam_frame = view.T_frame_cam.inverse()
    placed = [
        PlacedMesh(i + 1, thing.mesh, T_cam_frame @ thing.T_frame_obj)
        for i, thing in enumerate(things)
    ]
    for silhouette in compose(renderer, camera, placed).silhouettes:
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
