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
    along = rays @ T_world_cam.R.T
    eye = np.broadcast_to(T_world_cam.t, along.shape)
    # The ray parameter of a ray with z = 1 is the z-depth.
    hits = world.cast(eye, along)
    behind = world.cast(eye, along, through_glass=True)
    shape = (camera.height, camera.width)
    ids = np.maximum(hits.entity - 1, 0).reshape(shape)
    light = world.shade(hits, _unit(along))
    fine = np.flatnonzero(_needs_samples(ids, hits.entity.reshape(shape)))
    light[fine] = _supersampled(world, rays[fine], camera, T_world_cam, samples)
    return FrameMaps(
        _develop(light.reshape(*shape, 3), rng),
        np.where(np.isfinite(hits.t), hits.t, 0).reshape(shape),
        np.where(np.isfinite(behind.t), behind.t, 0).reshape(shape),
        ids,
    )


def _needs_samples(ids: NDArray[np.int64], entity: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Pixels at the border between two surfaces, where one ray would leave a jagged edge."""
    surface = (entity + 1).astype(np.uint8)
    near = np.ones((3, 3), np.uint8)
    border = cv2.dilate(surface, near) != cv2.erode(surface, near)
    # Mirrors and glass show borders of other things inside their own.
    return np.asarray(border | (cv2.dilate((ids > 0).astype(np.uint8), near) > 0))


def _supersampled(
    world: World,
    rays: NDArray[np.float64],
    camera: Camera,
    T_world_cam: SE3,
    samples: int,
) -> NDArray[np.float64]:
    """Mean radiance (N, 3) over samples x samples rays inside each pixel."""
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    total = np.zeros((len(rays), 3))
    for dx in offsets:
        for dy in offsets:
            shifted = rays + np.array([dx / camera.fx, dy / camera.fy, 0.0])
            along = _unit(shifted @ T_world_cam.R.T)
            total += world.radiance(np.broadcast_to(T_world_cam.t, along.shape), along)
    return total / samples**2


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _develop(light: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Linear radiance to 8-bit colour, with the camera's noise."""
    encoded = np.clip(light, 0, 1) ** (1 / 2.2) + rng.normal(0, 0.008, light.shape)
    return np.clip(encoded * 255 + 0.5, 0, 255).astype(np.uint8)
