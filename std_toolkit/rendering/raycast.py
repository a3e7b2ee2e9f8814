"""Exact renderer without GL: ray casting through pixel centres with Embree (Open3D).

The acceleration structure of a mesh is built in its centred coordinates, so a pose changes only
the rays. Ray directions have z = 1 in the camera frame, so the distance that Embree returns is the
z-depth.
"""

from collections import OrderedDict

import numpy as np

from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.renderer import NEAR_M, Raster, Window, normalised_rays

_KEPT_STRUCTURES = 64


class RaycastRenderer:
    """Renderer on `RayCaster`.

    Args:
        threads: threads per cast; 1 leaves the other cores to parallel jobs, 0 uses all cores.
    """

    name = "raycast"
    handles_distortion = True

    def __init__(self, *, threads: int = 1) -> None:
        self._threads = threads
        # The meshes are kept too, because an id() is unique only while its object is alive.
        self._structures: OrderedDict[int, tuple[RenderMesh, RayCaster]] = OrderedDict()

    def draw(self, camera: Camera, mesh: RenderMesh, T_cam_obj: SE3, *, window: Window) -> Raster:
        """See `Renderer.draw`. Supports distortion."""
        hits = self._structure(mesh).cast(_rays(camera, mesh, T_cam_obj, window))
        depth = hits.distance
        face = hits.face.view(np.int32)
        missed = ~np.isfinite(depth) | (depth <= NEAR_M)
        depth[missed] = 0
        face[missed] = -1
        return Raster(depth, face)

    def cast_at(
        self, camera: Camera, mesh: RenderMesh, T_cam_obj: SE3, *, where: np.ndarray
    ) -> np.ndarray:
        """Return (N,) float32 z-depth at the N true pixels of `where` (H,W), 0 outside the mesh."""
        inside = Window(0, 0, camera.width, camera.height)
        x, y = (np.broadcast_to(a, where.shape)[where] for a in normalised_rays(camera, inside))
        rays = np.empty((len(x), 6), np.float32)
        _fill(rays, x, y, mesh, T_cam_obj)
        depth = self._structure(mesh).cast(rays).distance
        depth[~np.isfinite(depth) | (depth <= NEAR_M)] = 0
        return depth

    def _structure(self, mesh: RenderMesh) -> RayCaster:
        kept = self._structures.get(id(mesh))
        if kept is not None:
            self._structures.move_to_end(id(mesh))
            return kept[1]
        structure = RayCaster(mesh.vertices, mesh.faces, threads=self._threads)
        self._structures[id(mesh)] = (mesh, structure)
        while len(self._structures) > _KEPT_STRUCTURES:
            self._structures.popitem(last=False)
        return structure


def _rays(camera: Camera, mesh: RenderMesh, T_cam_obj: SE3, window: Window) -> np.ndarray:
    """(h,w,6) float32 origins and directions in the mesh's centred coordinates."""
    rays = np.empty((window.height, window.width, 6), np.float32)
    _fill(rays, *normalised_rays(camera, window), mesh, T_cam_obj)
    return rays


def _fill(rays: np.ndarray, x: np.ndarray, y: np.ndarray, mesh: RenderMesh, T_cam_obj: SE3) -> None:
    R = T_cam_obj.R
    rays[..., :3] = -(R.T @ T_cam_obj.t) - mesh.centre
    for axis in range(3):
        rays[..., 3 + axis] = (R[0, axis] * x + R[2, axis]) + R[1, axis] * y
