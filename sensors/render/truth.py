"""Exact maps of a view, free of a renderer's noise: depth, instances, NOCS, normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.render.scene import SimScene
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.rendering.maps import compose, mask_of, surface_maps
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import PlacedMesh


@dataclass(frozen=True, eq=False)
class TruthMaps:
    """What the camera truly sees at its pixel centres.

    Attributes:
        depth: (H, W) float32 z-depth in metres of the first surface, glass and floor included;
            0 where there is none.
        mask: (H, W) uint8 instance id, 0 on the background.
        nocs: (H, W, 3) float32 in 0..1 on instances, else 0.
        normals: (H, W, 3) float32 camera frame, towards the camera; 0 where there is no surface.
    """

    depth: NDArray[np.float32]
    mask: NDArray[np.uint8]
    nocs: NDArray[np.float32]
    normals: NDArray[np.float32]


class TruthCaster:
    """Exact maps of one scene from any view; keeps the meshes' acceleration structures.

    Args:
        scene: what is there.
        threads: per cast; 0 takes all.
    """

    def __init__(self, scene: SimScene, *, threads: int = 1) -> None:
        self._objects = scene.objects
        self._renderer = RaycastRenderer(threads=threads)

    def maps(self, camera: Camera, T_world_cam: SE3) -> TruthMaps:
        """The maps of a view; a distorted camera is honoured."""
        T_cam_world = T_world_cam.inverse()
        placed = [
            PlacedMesh(o.instance_id, o.mesh.prepared, T_cam_world @ o.T_world_obj)
            for o in self._objects
        ]
        composition = compose(self._renderer, camera, placed)
        nocs, normals = surface_maps(camera, placed, composition)
        mask = mask_of(composition.index, [o.instance_id for o in self._objects])
        nocs[mask == 0] = 0
        return TruthMaps(composition.depth, mask, nocs, normals)
