"""Corners of boxes and their turns."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_SIGNS = np.array(list(product((1.0, -1.0), repeat=3))).T


def box_corners(RT: Floats, sizes: Floats) -> Floats:
    """Corners of boxes in the camera frame.

    Args:
        RT: (..., 4, 4) object to camera, the scale inside.
        sizes: (..., 3) along x, y, z before RT.

    Returns:
        (..., 3, 8) in metres; corners of two boxes at one index have the same signs of x, y, z.

    Raises:
        ValueError: shapes that do not go together.

    >>> box_corners(np.eye(4), np.array([2.0, 4.0, 6.0])).max(axis=-1).tolist()
    [1.0, 2.0, 3.0]
    """
    return RT[..., :3, :3] @ (sizes[..., :, None] / 2 * _SIGNS) + RT[..., :3, 3:]


def cube_to_box(RT: Floats, sizes: Floats) -> Floats:
    """Maps of the cube [-1, 1]^3 onto boxes.

    Args:
        RT: (..., 4, 4) object to camera, the scale inside.
        sizes: (..., 3) along x, y, z before RT.

    Returns:
        (..., 4, 4) in metres.

    Raises:
        ValueError: shapes that do not go together.

    >>> np.diag(cube_to_box(np.eye(4), np.array([2.0, 4.0, 6.0]))).tolist()
    [1.0, 2.0, 3.0, 1.0]
    """
    half = np.concatenate([sizes / 2, np.ones((*sizes.shape[:-1], 1))], axis=-1)
    return RT * half[..., None, :]


def turned_about_y(RT: Floats, turns: int) -> Floats:
    """Poses after equal parts of a full turn about the object's y axis.

    Args:
        RT: (N, 4, 4).
        turns: number of parts.

    Returns:
        (N, turns, 4, 4), the pose itself first.

    Raises:
        ValueError: shapes that do not go together.

    >>> turned_about_y(np.eye(4)[None], 2)[0, 1].round().diagonal().tolist()
    [-1.0, 1.0, -1.0, 1.0]
    """
    angle = 2 * np.pi * np.arange(turns) / turns
    Y = np.tile(np.eye(4), (turns, 1, 1))
    Y[:, 0, 0] = Y[:, 2, 2] = np.cos(angle)
    Y[:, 0, 2] = np.sin(angle)
    Y[:, 2, 0] = -Y[:, 0, 2]
    return RT[:, None] @ Y
