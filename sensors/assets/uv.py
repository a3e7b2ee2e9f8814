"""Texture coordinates for shapes that bring none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def box_uv(vertices: Array, faces: NDArray[np.integer]) -> NDArray[np.float32]:
    """(F, 3, 2) coordinates seen from the one of six sides that each face looks to most.

    Args:
        vertices: (V, 3) canonical; one unit of texture is one unit of length.
        faces: (F, 3).
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normal).argmax(axis=1)
    side = np.sign(np.take_along_axis(normal, axis[:, None], 1))
    x, y, z = np.moveaxis(corners, -1, 0)
    u = np.choose(axis[:, None], [-side * z, x, side * x])
    v = np.choose(axis[:, None], [y, -side * z, y])
    return (np.stack([u, v], axis=-1) + 0.5).astype(np.float32)


def wrapped_uv(vertices: Array, faces: NDArray[np.integer]) -> NDArray[np.float32]:
    """(F, 3, 2) coordinates wrapped round the y axis once, v along it; lids as `box_uv`.

    u goes past 1 on faces that cross the seam: the texture repeats there.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    u = np.arctan2(corners[..., 0], corners[..., 2]) / (2 * np.pi) + 0.5
    u = np.where(u.max(axis=1, keepdims=True) - u > 0.5, u + 1, u)
    wrapped = np.stack([u, corners[..., 1] + 0.5], axis=-1)
    lid = np.abs(normal[:, 1]) > 0.8 * np.linalg.norm(normal, axis=1)
    return np.where(lid[:, None, None], box_uv(vertices, faces), wrapped).astype(np.float32)
