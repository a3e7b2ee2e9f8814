"""Depth maps: z-depth in metres, 0 = no measurement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera


def unproject_depth(depth: NDArray[np.floating], camera: Camera) -> NDArray[np.float64]:
    """Camera-frame points (H, W, 3) in metres behind every pixel; (0, 0, 0) where depth is 0."""
    return camera.rays() * np.asarray(depth, dtype=np.float64)[..., None]


def z_to_distance(depth: NDArray[np.floating], camera: Camera) -> NDArray[np.float64]:
    """Distance from the camera centre (H, W), metres, of a z-depth map. 0 stays 0."""
    return np.asarray(depth, dtype=np.float64) * np.linalg.norm(camera.rays(), axis=-1)
