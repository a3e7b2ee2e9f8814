"""Images of the quick camera: colour, and the depth of an active stereo sensor.

The depth has noise, bias, holes, and failures on glass and metal.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.synthetic.raycast_world import World
from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.geometry import SE3, Camera

BASELINE_M = 0.055

# Spread of the disparity error: a D415 on a good target (Intel's figure for its D4xx line).
DISPARITY_NOISE_PX = 0.08


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
    depth: Array
    behind: Array
    ids: NDArray[np.int64]


def render_frame(
    world: World, camera: Camera, T_world_cam: SE3, *, rng: np.random.Generator, samples: int = 2
) -> FrameMaps:
    """Render one frame; colour has samples x samples rays per pixel, depth the centre ray."""
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


def _needs_samples(ids: NDArray[np.int64], entity: NDArray[np.int64]) -> Mask:
    """Pixels at the border between two surfaces, where one ray would give a jagged edge."""
    surface = (entity + 1).astype(np.uint8)
    near = np.ones((3, 3), np.uint8)
    border = cv2.dilate(surface, near) != cv2.erode(surface, near)
    # Mirrors and glass show borders of other objects inside their own.
    return np.asarray(border | (cv2.dilate((ids > 0).astype(np.uint8), near) > 0))


def _supersampled(
    world: World,
    rays: Array,
    camera: Camera,
    T_world_cam: SE3,
    samples: int,
) -> Array:
    """Mean radiance (N, 3) over samples x samples rays inside each pixel."""
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    total = np.zeros((len(rays), 3))
    for dx in offsets:
        for dy in offsets:
            shifted = rays + np.array([dx / camera.fx, dy / camera.fy, 0.0])
            along = _unit(shifted @ T_world_cam.R.T)
            total += world.radiance(np.broadcast_to(T_world_cam.t, along.shape), along)
    return total / samples**2


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _develop(light: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Linear radiance to 8-bit colour, with the camera's noise."""
    encoded = np.clip(light, 0, 1) ** (1 / 2.2) + rng.normal(0, 0.008, light.shape)
    return np.clip(encoded * 255 + 0.5, 0, 255).astype(np.uint8)


def sensor_depth(
    exact: NDArray[np.floating],
    behind: NDArray[np.floating],
    material: NDArray[np.integer],
    *,
    fx: float,
    bias: float,
    rng: np.random.Generator,
) -> Floats:
    """Simulated sensor depth (H, W) in metres, 0 = no measurement.

    Args:
        exact: (H, W) true z-depth, 0 = nothing hit.
        behind: (H, W) true z-depth ignoring transparent objects.
        material: (H, W) 0 background, 1 raw or diffuse, 2 transparent, 3 specular.
        fx: focal length in pixels.
        bias: factor on all depth (1.015: the sensor reads 1.5 % too far).
        rng: generator of noise and holes.
    """
    glass, metal = material == 2, material == 3
    depth = np.where(glass, behind, exact).astype(np.float64)
    # Matching windows smooth the noise over a few pixels.
    noise = DISPARITY_NOISE_PX * _smooth_noise(rng, exact.shape, 1.5)
    depth += np.where(depth > 0, noise * depth**2 / (fx * BASELINE_M), 0)
    # Metal mirrors the pattern: the matched depth is anywhere between the surface and the image.
    blobs = _smooth_noise(rng, exact.shape, 6)
    depth = np.where(metal, depth + 0.03 * np.abs(blobs), depth)
    missing = (depth <= 0) | (glass & (blobs > -1.0)) | (metal & (blobs > -0.8))
    missing |= _half_occluded(exact, fx)
    missing |= _edges(exact) & (rng.random(exact.shape) < 0.7)
    missing |= _smooth_noise(rng, exact.shape, 2) > 2.6
    return np.where(missing, 0, depth * bias).astype(np.float32)


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], sigma_px: float) -> Array:
    """Noise of unit variance that is smooth over about `sigma_px`."""
    noise = np.asarray(cv2.GaussianBlur(rng.normal(size=shape), (0, 0), sigma_px))
    return noise / noise.std()


def _edges(depth: NDArray[np.floating]) -> Mask:
    nearest = cv2.erode(depth.astype(np.float32), np.ones((5, 5)))
    farthest = cv2.dilate(depth.astype(np.float32), np.ones((5, 5)))
    return farthest - nearest > 0.03 * nearest


def _half_occluded(depth: NDArray[np.floating], fx: float) -> Mask:
    """Pixels of the left image that the right one, 55 mm to the right, cannot see."""
    width = depth.shape[1]
    disparity = np.where(depth > 0, fx * BASELINE_M / np.where(depth > 0, depth, 1), 0)
    column = np.arange(width) - disparity
    # A pixel is hidden if one further right lands on or left of it in the other image: the
    # running minimum from the right of the columns.
    seen_from_right = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth.shape, dtype=bool)
    hidden[:, :-1] = seen_from_right[:, 1:] < column[:, :-1] - 0.5
    return hidden | (column < 0)
