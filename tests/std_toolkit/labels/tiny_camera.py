"""The camera of the tiny scene and its poses on a circle."""

from __future__ import annotations

import numpy as np

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

CAMERA = Camera(160, 120, 200.0, 200.0, 79.5, 59.5)


def camera_pose(angle: float, *, radius: float = 0.6, height: float = 0.4) -> SE3:
    """T_world_cam of a camera on a circle around the world's z axis, looking at the origin."""
    position = np.array([radius * np.sin(angle), -radius * np.cos(angle), height])
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return SE3(np.stack([right, np.cross(forward, right), forward], axis=1), position)
