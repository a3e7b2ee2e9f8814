"""All objects of a scene as one ray-traced world: contours end where a nearer object begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.object_surface import surface_of, turned
from std_toolkit.labels.refine.problem import RefineObject

NONE = -1


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays meet, in the shape of the rays.

    Attributes:
        object: index of the object met, `NONE` for none.
        depth: z-depth in metres, inf for none.
        normal: (..., 3) unit normal of the surface in the world, facing the camera.
    """

    object: NDArray[np.int32]
    depth: NDArray[np.float32]
    normal: NDArray[np.float32]


class WorldCaster:
    """Rays against all objects at their current poses.

    The acceleration structures belong to the meshes and stay: moving an object costs nothing.

    Args:
        objects: meshes.
        poses: T_world_obj of each.
    """

    def __init__(self, objects: Sequence[RefineObject], poses: Sequence[SE3]) -> None:
        self._placed = [(surface_of(thing), T) for thing, T in zip(objects, poses, strict=True)]

    def cast(self, camera: Camera, T_world_cam: SE3, pixels: NDArray[np.floating]) -> Hits:
        """Rays through pixels (..., 2) of an undistorted camera."""
        uv = np.asarray(pixels)
        rays = np.ones((uv.size // 2, 3), np.float32)
        rays[:, 0] = ((uv[..., 0] - camera.cx) / camera.fx).ravel()
        rays[:, 1] = ((uv[..., 1] - camera.cy) / camera.fy).ravel()
        nearest = np.full(len(rays), np.inf, np.float32)
        index = np.full(len(rays), NONE, np.int32)
        normal = np.zeros((len(rays), 3), np.float32)
        T_cam_world = T_world_cam.inverse()
        for i, (surface, T_world_obj) in enumerate(self._placed):
            T_cam_obj = T_cam_world @ T_world_obj
            (tried,) = np.nonzero(surface.may_meet(rays, T_cam_obj))
            if not len(tried):
                continue
            hits = surface.cast(rays[tried], T_cam_obj)
            nearer = hits.depth < nearest[tried]
            seen = tried[nearer]
            nearest[seen] = hits.depth[nearer]
            index[seen] = i
            normal[seen] = turned(hits.normal[nearer], T_world_obj.R)
        shape = uv.shape[:-1]
        return Hits(index.reshape(shape), nearest.reshape(shape), normal.reshape(*shape, 3))


@dataclass(frozen=True, eq=False)
class Patch:
    """The neighbourhood of one object in one image.

    Attributes:
        x, y: pixel of the top-left corner.
        hits: for the (h, w) pixels of the patch.
    """

    x: int
    y: int
    hits: Hits


def cast_patch(
    caster: WorldCaster,
    thing: RefineObject,
    T_world_obj: SE3,
    camera: Camera,
    T_world_cam: SE3,
    *,
    margin: int,
) -> Patch | None:
    """All pixels around an object, `margin` wide; None where the object is out of view."""
    T_cam_obj = T_world_cam.inverse() @ T_world_obj
    used = _corners(thing)
    p = T_cam_obj @ used
    if (p[:, 2] < 0.02).any():
        return None
    uv = camera.project(p)
    low = np.floor(uv.min(axis=0)).astype(int) - margin
    high = np.ceil(uv.max(axis=0)).astype(int) + margin
    low = np.maximum(low, 0)
    high = np.minimum(high, [camera.width - 1, camera.height - 1])
    if (high - low < 4).any():
        return None
    v, u = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    hits = caster.cast(camera, T_world_cam, np.stack([u, v], axis=-1).astype(np.float64))
    return Patch(int(low[0]), int(low[1]), hits)


def _corners(thing: RefineObject) -> NDArray[np.float64]:
    used = thing.vertices[np.unique(thing.faces)] if len(thing.vertices) < 64 else thing.vertices
    low, high = used.min(axis=0), used.max(axis=0)
    return np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
