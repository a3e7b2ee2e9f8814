"""One object alone in one image, cast once and kept as long as neither it nor the camera moves.

A contour ends where another object begins, so every object's surroundings hold its neighbours. In
most steps only one of them has moved, and each lies in the surroundings of several others: layers
that are put together on top of each other save most of the rays.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.object_surface import ObjectSurface, rotated

Array32 = NDArray[np.float32]

# Nearer than this the box around an object has no image.
_NEAREST_M = 0.02
# Six objects in ten images at 1280x720 take about 60 MB.
_MOST_BYTES = 128 * 2**20


@dataclass(frozen=True, eq=False)
class Layer:
    """An object in the box of pixels that it may cover.

    Attributes:
        x, y: top-left pixel.
        depth: (h, w) z-depth in metres, inf where it is not met.
        normal: (3, h, w) unit normal in the world, facing the camera.
    """

    x: int
    y: int
    depth: Array32
    normal: Array32


def image_box(
    surface: ObjectSurface, T_cam_obj: SE3, camera: Camera
) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 (inclusive) around an object's image, not clipped to the camera's.

    None where a part of the object is beside or behind the camera.
    """
    p = T_cam_obj @ surface.outer
    nearest = float(p[:, 2].min()) - surface.slack
    if nearest < _NEAREST_M:
        return None
    uv = camera.project(p)
    slack = surface.slack / nearest * np.array([camera.fx, camera.fy])
    low = np.floor(uv.min(axis=0) - slack).astype(int)
    high = np.ceil(uv.max(axis=0) + slack).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


class LayerStore:
    """Layers by object, pose, and camera; the ones that were not used for longest are dropped."""

    def __init__(self) -> None:
        self._layers: OrderedDict[tuple[object, ...], Layer | None] = OrderedDict()
        self._bytes = 0

    def layer(
        self, surface: ObjectSurface, T_world_obj: SE3, camera: Camera, T_world_cam: SE3
    ) -> Layer | None:
        """The object in the camera's image; None where it is out of view.

        An object that reaches beside the camera is cast in the whole image.
        """
        poses = (T_world_obj.R, T_world_obj.t, T_world_cam.R, T_world_cam.t)
        # The surface itself is in the key: its id may be another's when it is gone.
        key = (surface, camera, *(a.tobytes() for a in poses))
        if key in self._layers:
            self._layers.move_to_end(key)
            return self._layers[key]
        layer = _cast(surface, T_world_obj, camera, T_world_cam)
        self._layers[key] = layer
        self._bytes += _size(layer)
        while self._bytes > _MOST_BYTES and len(self._layers) > 1:
            self._bytes -= _size(self._layers.popitem(last=False)[1])
        return layer


def _size(layer: Layer | None) -> int:
    return 0 if layer is None else layer.depth.nbytes + layer.normal.nbytes


def _cast(
    surface: ObjectSurface, T_world_obj: SE3, camera: Camera, T_world_cam: SE3
) -> Layer | None:
    T_cam_obj = T_world_cam.inverse() @ T_world_obj
    if (T_cam_obj @ surface.centre)[2] < -surface.radius:
        return None
    box = image_box(surface, T_cam_obj, camera) or (0, 0, camera.width - 1, camera.height - 1)
    x0, y0 = max(box[0], 0), max(box[1], 0)
    x1, y1 = min(box[2], camera.width - 1), min(box[3], camera.height - 1)
    if x1 < x0 or y1 < y0:
        return None
    x = ((np.arange(x0, x1 + 1) - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(y0, y1 + 1) - camera.cy) / camera.fy).astype(np.float32)[:, None]
    R = T_cam_obj.R.astype(np.float32)
    rays = np.empty((y1 + 1 - y0, x1 + 1 - x0, 6), np.float32)
    rays[..., :3] = T_cam_obj.inverse().t - surface.centre
    for k in range(3):
        rays[..., 3 + k] = x * R[0, k] + (y * R[1, k] + R[2, k])
    depth, found = surface.meet(rays)
    normal = np.ascontiguousarray(np.moveaxis(found, -1, 0))
    away = sum(normal[k] * rays[..., 3 + k] for k in range(3)) > 0
    normal *= np.where(away, np.float32(-1), np.float32(1))
    return Layer(x0, y0, depth, rotated(normal, T_world_obj.R))
