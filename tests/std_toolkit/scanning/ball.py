"""Photos of a painted ball on a table, drawn with NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.scanning.photos.views import View

CENTRE = np.array([0.01, -0.02, 0.05])
RADIUS = 0.04
CAMERA = Camera(160, 120, 260, 260, 79.5, 59.5)


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64]) -> SE3:
    """T_world_cam of a camera at `eye` that looks at `target`, with z up."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    return SE3(np.stack([x, np.cross(z, x), z], axis=1), eye)


def paint(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3) RGB of points: a texture with structure of 3 to 10 mm in all directions."""
    p = points - CENTRE
    wave = np.zeros(len(p))
    rng = np.random.default_rng(3)
    for _ in range(24):
        direction = rng.normal(size=3)
        direction *= 2 * np.pi / rng.uniform(0.006, 0.02) / np.linalg.norm(direction)
        wave += np.sin(p @ direction + rng.uniform(0, 6))
    grey = 128 + 22 * wave
    return np.clip(np.stack([grey, 0.8 * grey + 20, 0.6 * grey + 40], axis=1), 0, 255)


def ball_views(count: int = 16, *, camera: Camera = CAMERA) -> list[View]:
    """Photos from two heights, with exact masks."""
    views = []
    for n in range(count):
        angle = 2 * np.pi * n / count
        height = (0.16, 0.30)[n % 2]
        away = [0.24 * np.cos(angle), 0.24 * np.sin(angle), height - CENTRE[2]]
        eye = CENTRE + np.array(away)
        T = look_at(eye, CENTRE)
        rays = camera.rays() @ T.R.T
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        along = rays @ (CENTRE - eye)
        off2 = ((CENTRE - eye) ** 2).sum() - along**2
        mask = off2 < RADIUS**2
        image = np.full((*mask.shape, 3), 12, np.uint8)
        t = along[mask] - np.sqrt(RADIUS**2 - off2[mask])
        image[mask] = paint(eye + t[:, None] * rays[mask]).astype(np.uint8)
        views.append(View(f"{n:03d}.png", image, camera, T, mask))
    return views
