"""Rays against the labelled objects where they stand in the world.

The renderers draw pixel grids. A contour to a fraction of a pixel needs rays at any place in the
image, and objects that do not move need their acceleration structure once per scene, not per
frame. So this asks Embree (Open3D) directly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.scene import Scene

NOTHING = 0
"""Object id where a ray meets no object."""


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays met.

    Attributes:
        object_id: (...,) int32, `NOTHING` where no object is.
        depth: (...,) float32 z-depth in metres, 0 where no object is.
    """

    object_id: NDArray[np.int32]
    depth: NDArray[np.float32]


class LabelCaster:
    """The labelled objects of a scene in the world frame.

    Args:
        objects: object id to (vertices (V,3) in the world in metres, faces (F,3)).
    """

    def __init__(self, objects: Mapping[int, tuple[NDArray[Any], NDArray[Any]]]) -> None:
        import open3d as o3d

        self.object_ids = sorted(objects)
        self._all = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._single: dict[int, Any] = {}
        self.corners: dict[int, NDArray[np.float64]] = {}
        for object_id in self.object_ids:
            vertices, faces = objects[object_id]
            v = o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, dtype=np.float32))
            f = o3d.core.Tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32))
            self._all.add_triangles(v, f)
            self._single[object_id] = o3d.t.geometry.RaycastingScene(nthreads=1)
            self._single[object_id].add_triangles(v, f)
            used = np.asarray(vertices, dtype=np.float64)[np.unique(faces)]
            low, high = used.min(axis=0), used.max(axis=0)
            self.corners[object_id] = np.array(
                [
                    [x, y, z]
                    for x in (low[0], high[0])
                    for y in (low[1], high[1])
                    for z in (low[2], high[2])
                ]
            )

    @staticmethod
    def of_scene(scene: Scene) -> LabelCaster:
        """The objects of a scene that have a pose in the world and a mesh that can be read."""
        objects = {}
        for item in scene.objects.objects:
            T_world_obj = scene.T_world_obj(item.id)
            if T_world_obj is None or mesh_problem(scene, item.model) is not None:
                continue
            mesh = scene.mesh(item.model)
            objects[item.id] = (T_world_obj @ np.asarray(mesh.vertices), np.asarray(mesh.faces))
        return LabelCaster(objects)

    def cast(
        self,
        camera: Camera,
        T_world_cam: SE3,
        uv: NDArray[np.floating],
        *,
        only: int | None = None,
    ) -> Hits:
        """The nearest object behind pixels.

        Args:
            camera: intrinsics; distortion is honoured.
            T_world_cam: pose of the camera.
            uv: (..., 2) pixel coordinates, anywhere.
            only: look at this object alone, as if the others were not there.
        """
        import open3d as o3d

        # Directions with z = 1 in the camera frame make the distance that comes back the z-depth.
        directions = camera.unproject(uv) @ T_world_cam.R.T
        rays = np.empty((*directions.shape[:-1], 6), dtype=np.float32)
        rays[..., :3] = T_world_cam.t
        rays[..., 3:] = directions
        structure = self._all if only is None else self._single[only]
        if not self.object_ids:
            shape = directions.shape[:-1]
            return Hits(np.zeros(shape, np.int32), np.zeros(shape, np.float32))
        answer = structure.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)
        depth = answer["t_hit"].numpy()
        hit = np.isfinite(depth) & (depth > 0)
        table = np.array(self.object_ids if only is None else [only], dtype=np.int32)
        index = np.where(hit, answer["geometry_ids"].numpy().astype(np.int64), 0)
        return Hits(
            np.where(hit, table[index], NOTHING).astype(np.int32),
            np.where(hit, depth, 0).astype(np.float32),
        )

    def window(
        self, object_id: int, camera: Camera, T_world_cam: SE3
    ) -> tuple[int, int, int, int] | None:
        """Pixels x0, y0, x1, y1 (exclusive) that may show the object, clipped to the image.

        The whole image when the object reaches behind the camera; None when it is out of view.
        """
        p = T_world_cam.inverse() @ self.corners[object_id]
        if (p[:, 2] <= 0).all():
            return None
        if (p[:, 2] <= 0.01).any():
            return 0, 0, camera.width, camera.height
        # The corners' bounding box bounds the projection of a pinhole. A lens bends the lines
        # between the corners too, by less than the margin.
        uv = camera.project(p)
        if not np.isfinite(uv).all():  # beyond what the lens model covers
            return 0, 0, camera.width, camera.height
        margin = 2 + (0.05 * camera.width if camera.is_distorted else 0)
        x0, y0 = np.floor(uv.min(axis=0) - margin)
        x1, y1 = np.ceil(uv.max(axis=0) + margin) + 1
        box = (
            int(np.clip(x0, 0, camera.width)),
            int(np.clip(y0, 0, camera.height)),
            int(np.clip(x1, 0, camera.width)),
            int(np.clip(y1, 0, camera.height)),
        )
        return box if box[2] > box[0] and box[3] > box[1] else None


def mesh_problem(scene: Scene, model_id: str) -> str | None:
    """Why the mesh of a model cannot be used, in one line; None if it can."""
    try:
        scene.mesh(model_id)
    except ToolkitError as error:
        return str(error)
    return None
