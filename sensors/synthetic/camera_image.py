"""One frame of the synthetic recording: colour with anti-aliasing, exact depth and ids."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.synthetic.world import World
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3


@dataclass(frozen=True)
class FrameMaps:
    """Maps of one frame, all (H, W).

    Attributes:
        color: (H, W, 3) uint8 RGB.
        depth: z-depth of the first surface, metres, 0 = none.
        behind: the same ignoring transparent objects.
        ids: 0 background, 1 + i for object i.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float64]
    behind: NDArray[np.float64]
    ids: NDArray[np.int64]


def render_frame(
    world: World, camera: Camera, T_world_cam: SE3, *, rng: np.random.Generator, samples: int = 2
) -> FrameMaps:
    """Render one frame; colour has samples x samples rays a pixel, depth the centre ray."""
    rays = camera.rays().reshape(-1, 3)
    eye = np.broadcast_to(T_world_cam.t, rays.shape)
    along = rays @ T_world_cam.R.T
    # The ray parameter of a ray with z = 1 is the z-depth.
    hits = world.cast(eye, along)
    behind = world.cast(eye, along, through_glass=True)
    shape = (camera.height, camera.width)
    return FrameMaps(
        _colour(world, camera, T_world_cam, rng, samples),
        np.where(np.isfinite(hits.t), hits.t, 0).reshape(shape),
        np.where(np.isfinite(behind.t), behind.t, 0).reshape(shape),
        np.maximum(hits.entity - 1, 0).reshape(shape),
    )


def _colour(
    world: World, camera: Camera, T_world_cam: SE3, rng: np.random.Generator, samples: int
) -> NDArray[np.uint8]:
    # A pixel of the fine grid covers 1/samples of a pixel: `resized` keeps image edges, so the
    # mean over the block is centred on the pixel centre.
    fine = camera.resized(camera.width * samples, camera.height * samples)
    rays = fine.rays().reshape(-1, 3) @ T_world_cam.R.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    light = world.radiance(np.broadcast_to(T_world_cam.t, rays.shape), rays)
    image = np.clip(light, 0, 1).astype(np.float32).reshape(fine.height, fine.width, 3)
    image = np.asarray(cv2.resize(image, camera.size, interpolation=cv2.INTER_AREA))
    encoded = image ** (1 / 2.2) + rng.normal(0, 0.008, image.shape)
    return np.clip(encoded * 255 + 0.5, 0, 255).astype(np.uint8)
