"""All objects of a scene as one ray-traced world: contours end where a nearer object begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
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

    Args:
        objects: meshes.
        poses: T_world_obj of each.
    """

    def __init__(self, objects: Sequence[RefineObject], poses: Sequence[SE3]) -> None:
        import open3d as o3d

        self._scene = o3d.t.geometry.RaycastingScene()
        # Embree works in float32: coordinates near the objects keep their digits.
        self._origin = np.mean([T.t for T in poses], axis=0)
        for thing, T in zip(objects, poses, strict=True):
            self._scene.add_triangles(
                o3d.core.Tensor.from_numpy((T @ thing.vertices - self._origin).astype(np.float32)),
                o3d.core.Tensor.from_numpy(thing.faces.astype(np.uint32)),
            )

    def cast(self, camera: Camera, T_world_cam: SE3, pixels: NDArray[np.floating]) -> Hits:
        """Rays through pixels (..., 2) of an undistorted camera."""
        import open3d as o3d

        uv = np.asarray(pixels)
        rays = np.empty((*uv.shape[:-1], 6), np.float32)
        directions = np.stack(
            [(uv[..., 0] - camera.cx) / camera.fx, (uv[..., 1] - camera.cy) / camera.fy], axis=-1
        )
        # Directions have z = 1 in the camera frame, so the distance returned is the z-depth.
        R = T_world_cam.R
        rays[..., :3] = T_world_cam.t - self._origin
        rays[..., 3:] = directions @ R[:, :2].T + R[:, 2]
        found = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        ids = found["geometry_ids"].numpy()
        normal = found["primitive_normals"].numpy()
        facing = (normal * rays[..., 3:]).sum(axis=-1, keepdims=True)
        return Hits(
            np.where(ids == self._scene.INVALID_ID, NONE, ids.astype(np.int64)).astype(np.int32),
            found["t_hit"].numpy(),
            np.where(facing > 0, -normal, normal),
        )


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
