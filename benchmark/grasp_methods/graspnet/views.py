"""Approach views, and the gripper's turns about them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def fibonacci_views(count: int) -> Floats:
    """(count, 3) unit vectors, evenly spread over the sphere; a gripper comes from there."""
    turn = np.arange(count) * np.pi * (np.sqrt(5) - 1)
    z = (2 * np.arange(count) + 1) / count - 1
    around = np.sqrt(1 - z * z)
    return np.stack([around * np.cos(turn), around * np.sin(turn), z], axis=1)


def rotation_of(approaches: ArrayLike, turns: ArrayLike = 0.0) -> Floats:
    """(..., 3, 3) gripper rotations: x along the approach, y level before the turn about x.

    Args:
        approaches: (..., 3) unit vectors.
        turns: (...,) radians.
    """
    x = np.asarray(approaches, dtype=np.float64)
    y = np.stack([-x[..., 1], x[..., 0], np.zeros_like(x[..., 0])], axis=-1)
    length = np.linalg.norm(y, axis=-1, keepdims=True)
    # Straight up or down every y is level.
    y = np.where(length > 1e-9, y / np.maximum(length, 1e-9), [0.0, 1.0, 0.0])
    z = np.cross(x, y)
    c, s = (f(np.asarray(turns, dtype=np.float64))[..., None] for f in (np.cos, np.sin))
    return np.stack([np.broadcast_to(x, (c * y).shape), c * y + s * z, c * z - s * y], axis=-1)


def gripper_rotations(views: int, angles: int) -> Floats:
    """(views, angles, 3, 3) rotations of all views, turned by equal steps over half a turn."""
    turns = np.arange(angles) * np.pi / angles
    return rotation_of(-fibonacci_views(views)[:, None], turns[None])
