"""What an active stereo camera would report: noise, bias, holes, and failure on glass and metal."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

BASELINE_M = 0.055
# Spread of the disparity error: a D415 on a good target (Intel's figure for its D4xx line).
DISPARITY_NOISE_PX = 0.08


def sensor_depth(
    exact: NDArray[np.floating],
    behind: NDArray[np.floating],
    material: NDArray[np.integer],
    *,
    fx: float,
    bias: float,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Simulated sensor depth (H, W) in metres, 0 = no measurement.

    Args:
        exact: (H, W) true z-depth, 0 = nothing hit.
        behind: (H, W) true z-depth ignoring transparent objects.
        material: (H, W) 0 background, 1 raw or diffuse, 2 transparent, 3 specular.
        fx: focal length in pixels.
        bias: factor on all depth (1.015: the sensor reads 1.5 % too far).
        rng: of noise and holes.
    """
    glass, metal = material == 2, material == 3
    depth = np.where(glass, behind, exact).astype(np.float64)
    # Matching windows make the noise smooth over a few pixels.
    noise = DISPARITY_NOISE_PX * _smooth_noise(rng, exact.shape, 1.5)
    depth += np.where(depth > 0, noise * depth**2 / (fx * BASELINE_M), 0)
    # Metal mirrors the pattern: what is matched there is anywhere between it and its image.
    blobs = _smooth_noise(rng, exact.shape, 6)
    depth = np.where(metal, depth + 0.03 * np.abs(blobs), depth)
    missing = (depth <= 0) | (glass & (blobs > -1.0)) | (metal & (blobs > -0.8))
    missing |= _half_occluded(exact, fx)
    missing |= _edges(exact) & (rng.random(exact.shape) < 0.7)
    missing |= _smooth_noise(rng, exact.shape, 2) > 2.6
    return np.where(missing, 0, depth * bias).astype(np.float32)


def _smooth_noise(
    rng: np.random.Generator, shape: tuple[int, ...], sigma_px: float
) -> NDArray[np.float64]:
    """Noise of unit variance that is smooth over about `sigma_px`."""
    noise = np.asarray(cv2.GaussianBlur(rng.normal(size=shape), (0, 0), sigma_px))
    return noise / noise.std()


def _edges(depth: NDArray[np.floating]) -> NDArray[np.bool_]:
    nearest = cv2.erode(depth.astype(np.float32), np.ones((5, 5)))
    farthest = cv2.dilate(depth.astype(np.float32), np.ones((5, 5)))
    return farthest - nearest > 0.03 * nearest


def _half_occluded(depth: NDArray[np.floating], fx: float) -> NDArray[np.bool_]:
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
