"""Ray casting of all objects of a scene: contours end where a nearer object begins.

The surroundings of every object include its neighbours, because they occlude its contour. A layer
is the rendering of one object in one image. It is cached until the object or the camera moves. In
most steps only one object moves, so composing cached layers saves most rays.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine import patch_pixels
from std_toolkit.labels.refine.object_surface import ObjectSurface, turned
from std_toolkit.labels.refine.problem import RefineObject

NONE = -1

Array32 = NDArray[np.float32]

# The bounding box of an object has no projection if it is nearer than this.
_NEAREST_M = 0.02

# Six objects in ten images at 1280x720 take about 60 MB.
_MOST_BYTES = 128 * 2**20


@dataclass(frozen=True, eq=False)
class Hits:
    """Hits of rays, in the shape of the rays.

    Attributes:
        object: index of the object, `NONE` without a hit.
        depth: z-depth in metres, inf for none.
        normal: (..., 3) unit normal of the surface in the world, facing the camera.
    """

    object: NDArray[np.int32]
    depth: NDArray[np.float32]
    normal: NDArray[np.float32]


class WorldCaster:
    """Rays against all objects at their current poses.

    The acceleration structures belong to the meshes, so moving an object costs nothing.

    Args:
        objects: meshes.
        poses: T_world_obj of each.
        layers: layers of earlier casters, reused for objects that did not move.
    """

    def __init__(
        self,
        objects: Sequence[RefineObject],
        poses: Sequence[SE3],
        layers: LayerStore | None = None,
    ) -> None:
        self._placed = [(obj.surface, T) for obj, T in zip(objects, poses, strict=True)]
        self._layers = LayerStore() if layers is None else layers
        self._view: tuple[SE3 | None, list[SE3]] = None, []

    def _seen_from(self, T_world_cam: SE3) -> list[SE3]:
        """T_cam_obj of every object; kept for further rays of the same camera."""
        if self._view[0] is not T_world_cam:
            T_cam_world = T_world_cam.inverse()
            self._view = T_world_cam, [T_cam_world @ T for _, T in self._placed]
        return self._view[1]

    def cast(
        self,
        camera: Camera,
        T_world_cam: SE3,
        pixels: NDArray[np.floating],
        among: Sequence[int] | None = None,
        facing: NDArray[np.bool_] | None = None,
    ) -> Hits:
        """Rays through pixels (..., 2) of an undistorted camera.

        Args:
            among: indices of the objects to intersect; default: all.
            facing: flags (...) of the rays whose normals are needed, the others get 0; default:
                all.
        """
        uv = np.asarray(pixels)
        rays = np.ones((uv.size // 2, 3), np.float32)
        x, y = camera.pinhole_rays(uv[..., 0], uv[..., 1])
        rays[:, 0], rays[:, 1] = x.ravel(), y.ravel()
        nearest = np.full(len(rays), np.inf, np.float32)
        index = np.full(len(rays), NONE, np.int32)
        normal = np.zeros((len(rays), 3), np.float32)
        for i in range(len(self._placed)) if among is None else among:
            surface, T_world_obj = self._placed[i]
            T_cam_obj = self._seen_from(T_world_cam)[i]
            near = surface.may_meet(rays, T_cam_obj)
            if near.all():
                hits = surface.cast(rays, T_cam_obj)
                seen = nearer = np.flatnonzero(hits.depth < nearest)
            else:
                tried = np.flatnonzero(near)
                if not len(tried):
                    continue
                hits = surface.cast(rays[tried], T_cam_obj)
                nearer = np.flatnonzero(hits.depth < nearest[tried])
                seen = tried[nearer]
            nearest[seen] = hits.depth[nearer]
            index[seen] = i
            if facing is not None:
                chosen = facing.ravel()[seen]
                nearer, seen = nearer[chosen], seen[chosen]
            if len(seen):
                normal[seen] = turned(hits.facing(nearer), T_world_obj.R)
        shape = uv.shape[:-1]
        return Hits(index.reshape(shape), nearest.reshape(shape), normal.reshape(*shape, 3))

    def window(
        self, camera: Camera, T_world_cam: SE3, box: tuple[int, int, int, int]
    ) -> tuple[Hits, tuple[int, ...]]:
        """All pixels of a box x0, y0, x1, y1 (inclusive), and the objects that reach into it."""
        x0, y0, x1, y1 = box
        shape = y1 + 1 - y0, x1 + 1 - x0
        nearest = np.full(shape, np.inf, np.float32)
        index = np.full(shape, NONE, np.int32)
        normal = np.zeros((3, *shape), np.float32)
        among = []
        for i, (surface, T_world_obj) in enumerate(self._placed):
            layer = self._layers.layer(surface, T_world_obj, camera, T_world_cam, near=box)
            if layer is None:
                continue
            h, w = layer.depth.shape
            left, right = max(layer.x, x0), min(layer.x + w, x1 + 1)
            top, bottom = max(layer.y, y0), min(layer.y + h, y1 + 1)
            if left >= right or top >= bottom:
                continue
            among.append(i)
            here = slice(top - y0, bottom - y0), slice(left - x0, right - x0)
            there = slice(top - layer.y, bottom - layer.y), slice(left - layer.x, right - layer.x)
            nearer = layer.depth[there] < nearest[here]
            np.copyto(nearest[here], layer.depth[there], where=nearer)
            np.copyto(
                normal[(slice(None), *here)], layer.normal[(slice(None), *there)], where=nearer
            )
            index[here][nearer] = i
        return Hits(index, nearest, np.moveaxis(normal, 0, -1)), tuple(among)


@dataclass(frozen=True, eq=False)
class Patch:
    """The neighbourhood of one object in one image.

    Attributes:
        x, y: pixel of the top-left corner.
        hits: hits of the (h, w) pixels of the patch.
        among: indices of the objects that reach into it.
    """

    x: int
    y: int
    hits: Hits
    among: tuple[int, ...]


def cast_patch(
    caster: WorldCaster,
    obj: RefineObject,
    T_world_obj: SE3,
    camera: Camera,
    T_world_cam: SE3,
    *,
    margin: int,
) -> Patch | None:
    """All pixels around an object, `margin` wide; None if the object is out of view."""
    around = image_box(obj.surface, T_world_cam.inverse() @ T_world_obj, camera)
    if around is None:
        return None
    x0, y0 = max(around[0] - margin, 0), max(around[1] - margin, 0)
    x1 = min(around[2] + margin, camera.width - 1)
    y1 = min(around[3] + margin, camera.height - 1)
    if x1 - x0 < 4 or y1 - y0 < 4:
        return None
    hits, among = caster.window(camera, T_world_cam, (x0, y0, x1, y1))
    return Patch(x0, y0, hits, among)


@dataclass(frozen=True, eq=False)
class Layer:
    """An object in the box of pixels that it may cover.

    Attributes:
        x, y: top-left pixel.
        depth: (h, w) z-depth in metres, inf without a hit.
        normal: (3, h, w) unit normal in the world, facing the camera.
    """

    x: int
    y: int
    depth: Array32
    normal: Array32


def image_box(
    surface: ObjectSurface, T_cam_obj: SE3, camera: Camera
) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 (inclusive) around the image of an object, not clipped to the camera image.

    None if a part of the object is beside or behind the camera.
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
    """Cache of layers by object, pose, and camera; the least recently used are removed."""

    def __init__(self) -> None:
        self._layers: OrderedDict[tuple[object, ...], Layer | None] = OrderedDict()
        self._bytes = 0

    def layer(
        self,
        surface: ObjectSurface,
        T_world_obj: SE3,
        camera: Camera,
        T_world_cam: SE3,
        *,
        near: tuple[int, int, int, int] | None = None,
    ) -> Layer | None:
        """The object in the camera image; None if it is out of view.

        An object outside the box `near`, x0, y0, x1, y1 (inclusive), need not be cast: None, too.
        An object that reaches beside the camera is cast in the whole image.
        """
        poses = (T_world_obj.R, T_world_obj.t, T_world_cam.R, T_world_cam.t)
        # The surface itself is in the key: its id() may be reused after it is deleted.
        key = (surface, camera, *(a.tobytes() for a in poses))
        if key in self._layers:
            self._layers.move_to_end(key)
            return self._layers[key]
        T_cam_obj = T_world_cam.inverse() @ T_world_obj
        covered = _covered(surface, T_cam_obj, camera)
        if covered is not None and near is not None and _apart(covered, near):
            return None
        layer = None if covered is None else _cast(surface, T_world_obj, camera, T_cam_obj, covered)
        self._layers[key] = layer
        self._bytes += _size(layer)
        while self._bytes > _MOST_BYTES and len(self._layers) > 1:
            self._bytes -= _size(self._layers.popitem(last=False)[1])
        return layer


def _size(layer: Layer | None) -> int:
    return 0 if layer is None else layer.depth.nbytes + layer.normal.nbytes


def _covered(
    surface: ObjectSurface, T_cam_obj: SE3, camera: Camera
) -> tuple[int, int, int, int] | None:
    """Pixels x0, y0, x1, y1 (inclusive) of the image that an object may cover; None if none."""
    if (T_cam_obj @ surface.centre)[2] < -surface.radius:
        return None
    box = image_box(surface, T_cam_obj, camera) or (0, 0, camera.width - 1, camera.height - 1)
    x0, y0 = max(box[0], 0), max(box[1], 0)
    x1, y1 = min(box[2], camera.width - 1), min(box[3], camera.height - 1)
    return None if x1 < x0 or y1 < y0 else (x0, y0, x1, y1)


def _apart(a: tuple[int, ...], b: tuple[int, ...]) -> bool:
    """Whether two boxes x0, y0, x1, y1 (inclusive) have no pixel in common."""
    return a[2] < b[0] or b[2] < a[0] or a[3] < b[1] or b[3] < a[1]


def _cast(
    surface: ObjectSurface,
    T_world_obj: SE3,
    camera: Camera,
    T_cam_obj: SE3,
    box: tuple[int, int, int, int],
) -> Layer:
    x0, y0, x1, y1 = box
    across, down = camera.pinhole_rays(np.arange(x0, x1 + 1), np.arange(y0, y1 + 1))
    x, y = across.astype(np.float32), down.astype(np.float32)
    rays = np.empty((1, len(y), len(x), 6), np.float32)
    eye = (T_cam_obj.inverse().t - surface.centre).astype(np.float32)
    R = np.ascontiguousarray(T_cam_obj.R, np.float32)
    patch_pixels.fill_rays(eye[None], R[None], x[None], y[None], rays)
    depth, normal = surface.meet(rays[0])
    R = np.ascontiguousarray(T_world_obj.R, np.float32)
    return Layer(x0, y0, depth, patch_pixels.facing_normals(normal, rays[0], R))
