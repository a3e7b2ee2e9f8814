"""A hand-held arc around the table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3

# Where the camera looks: a little above the table's middle.
TARGET_M = np.array([0.0, 0.0, 0.05])


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64], *, roll: float = 0.0) -> SE3:
    """T_world_cam of a camera at `eye` that looks at `target`; world z up, OpenCV camera."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return SE3(np.stack([c * right + s * down, c * down - s * right, forward], axis=1), eye)


def arc(
    frames: int, *, degrees: float, radius_m: float, seed: int, start_degrees: float = -60.0
) -> list[SE3]:
    """T_world_cam along an arc, with the slow wander and the tremor of a hand."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 1, frames)
    azimuth = np.radians(start_degrees + degrees * s)
    phase = rng.uniform(0, 2 * np.pi, 4)
    elevation = np.radians(42 + 7 * np.sin(2 * np.pi * s + phase[0]))
    radius = radius_m * (1 + 0.06 * np.sin(3 * np.pi * s + phase[1]))
    poses = []
    for i in range(frames):
        horizontal = radius[i] * np.cos(elevation[i])
        outward = [horizontal * np.cos(azimuth[i]), horizontal * np.sin(azimuth[i])]
        eye = TARGET_M + np.array([*outward, radius[i] * np.sin(elevation[i])])
        target = TARGET_M + 0.02 * np.sin([5 * s[i] + phase[2], 4 * s[i] + phase[3], 0.0])
        tremor = rng.normal(0, 0.0015, 3)
        poses.append(look_at(eye + tremor, target, roll=0.05 * np.sin(6 * s[i] + phase[0])))
    return poses
