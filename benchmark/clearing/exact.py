"""What the camera truly sees of the objects on the table, and what lies behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND
from sensors.physics import PhysicalObject
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.rendering.maps import compose, surface_maps
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.protocol import PlacedMesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.windows import image_window


@dataclass(frozen=True, eq=False)
class ExactView:
    """A view of the table; the maps have the camera's size.

    Attributes:
        depth: float32 metres, z-depth of the first surface, glass and table included.
        mask: uint8 index of the object, `BACKGROUND` on the table.
        behind: float32 metres, of the next object or the table behind the object that is seen;
            equal to `depth` on the table.
        normals: (h, w, 3) float32 in the camera's frame, towards the camera.
    """

    depth: NDArray[np.float32]
    mask: NDArray[np.uint8]
    behind: NDArray[np.float32]
    normals: NDArray[np.float32]


class ExactCamera:
    """A camera that stands still above the table, whose plane is z = 0.

    Args:
        camera: without distortion.
        T_world_cam: where it stands; every pixel must see the table's plane.
    """

    def __init__(self, camera: Camera, T_world_cam: SE3) -> None:
        self.camera, self.T_world_cam = camera, T_world_cam
        self._renderer = RaycastRenderer(threads=1)
        self._meshes: dict[tuple[str, float], RenderMesh] = {}
        down = camera.rays() @ T_world_cam.R[2]
        self.table = (-T_world_cam.t[2] / down).astype(np.float32)

    def look(self, objects: Sequence[PhysicalObject], poses: Sequence[SE3]) -> ExactView:
        """The view of objects at poses T_world_obj."""
        T_cam_world = self.T_world_cam.inverse()
        placed = [
            PlacedMesh(i + 1, self._mesh(o), T_cam_world @ T)
            for i, (o, T) in enumerate(zip(objects, poses, strict=True))
        ]
        up = T_cam_world.R[:, 2].astype(np.float32)
        depth, behind = self.table.copy(), self.table.copy()
        mask = np.full(depth.shape, BACKGROUND, np.uint8)
        normals = np.broadcast_to(up, (*depth.shape, 3)).copy()
        if not placed:
            return ExactView(depth, mask, behind, normals)
        seen = compose(self._renderer, self.camera, placed)
        on = (seen.index >= 0) & (seen.depth < self.table)
        depth[on], mask[on] = seen.depth[on], seen.index[on].astype(np.uint8)
        normals[on] = surface_maps(self.camera, placed, seen)[1][on]
        for i, outline in enumerate(seen.silhouettes):
            if outline.image is None or outline.image_window is None:
                continue
            place = outline.image_window.slices_in(image_window(self.camera))
            there = outline.image.depth
            later = (there > 0) & (mask[place] != i) & on[place] & (there < behind[place])
            np.copyto(behind[place], there, where=later)
        return ExactView(depth, mask, behind, normals)

    def _mesh(self, thing: PhysicalObject) -> RenderMesh:
        key = (thing.asset.id, thing.diagonal_m)
        if key not in self._meshes:
            self._meshes[key] = RenderMesh.from_arrays(
                thing.asset.vertices * thing.diagonal_m, thing.asset.faces
            )
        return self._meshes[key]
