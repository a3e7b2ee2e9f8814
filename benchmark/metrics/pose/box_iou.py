"""Oriented boxes: corners, and their intersection over union in three definitions.

Corners of boxes and their turns.
"""

from __future__ import annotations

from enum import Enum
from itertools import product

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.pose.intersection import common_volume
from std_toolkit.errors import ToolkitError

_SIGNS = np.array(list(product((1.0, -1.0), repeat=3))).T

Floats = NDArray[np.float64]


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


class BoxIoU(Enum):
    """What overlap of two boxes means.

    Attributes:
        ORIENTED: the common volume of the boxes themselves, exact.
        AABB: of the boxes around them along the camera's axes, which grow as an object turns
            (the later half of the field, DREDS and CATRE among it).
        NOCS2019: of eight intervals, one for each corner, from its least to its largest coordinate
            (NOCS' released evaluation takes minimum and maximum over the wrong axis, and most of
            the field's figures until 2022 come from it).
    """

    ORIENTED = "oriented"
    AABB = "aabb"
    NOCS2019 = "nocs2019"


def box_iou(
    RT_a: Floats,
    sizes_a: Floats,
    RT_b: Floats,
    sizes_b: Floats,
    definition: BoxIoU = BoxIoU.ORIENTED,
    *,
    round_about_y: NDArray[np.bool_] | None = None,
    turns: int = 20,
) -> Floats:
    """Overlap of boxes, pair by pair.

    Args:
        RT_a, RT_b: (N, 4, 4) object to camera, the scale inside, metres.
        sizes_a, sizes_b: (N, 3) of the boxes along x, y, z before RT.
        definition: of the overlap.
        round_about_y: (N,) pairs whose object looks the same after a turn about y: the best of
            `turns` turns of box a counts. None of them by default.
        turns: equal parts of a full turn.

    Returns:
        (N,) overlaps in [0, 1]; 0 for boxes without volume.

    Raises:
        ToolkitError: shapes that do not belong together, or no turns.

    >>> moved = np.eye(4)[None].copy()
    >>> moved[0, 0, 3] = 0.5
    >>> cube = np.ones((1, 3))
    >>> box_iou(np.eye(4)[None], cube, moved, cube).round(6).tolist()  # 0.5 of 1.5
    [0.333333]
    """
    a, b = (np.asarray(x, dtype=np.float64) for x in (RT_a, RT_b))
    size_a, size_b = (np.asarray(x, dtype=np.float64) for x in (sizes_a, sizes_b))
    n = len(a)
    shapes = (a.shape, size_a.shape, b.shape, size_b.shape)
    if shapes != ((n, 4, 4), (n, 3), (n, 4, 4), (n, 3)) or turns < 1:
        raise ToolkitError("needs poses (N, 4, 4), sizes (N, 3) and turns", value=(shapes, turns))
    turning = np.zeros(n, dtype=bool) if round_about_y is None else np.asarray(round_about_y)
    if turning.shape != (n,):
        raise ToolkitError("must have shape (N,)", field="round_about_y", value=turning.shape)
    overlap = np.empty(n)
    still = ~turning
    overlap[still] = _iou(a[still], size_a[still], b[still], size_b[still], definition)
    if turning.any():
        many = turned_about_y(a[turning], turns).reshape(-1, 4, 4)
        own, other, its = (np.repeat(x[turning], turns, axis=0) for x in (size_a, b, size_b))
        found = _iou(many, own, other, its, definition)
        overlap[turning] = found.reshape(-1, turns).max(axis=1)
    return overlap


def _iou(a: Floats, size_a: Floats, b: Floats, size_b: Floats, definition: BoxIoU) -> Floats:
    if definition is BoxIoU.ORIENTED:
        A, B = cube_to_box(a, size_a), cube_to_box(b, size_b)
        common = common_volume(A, B)
        volumes = [8 * np.abs(np.linalg.det(M[:, :3, :3])) for M in (A, B)]
    else:
        axis = 2 if definition is BoxIoU.AABB else 1
        corners = box_corners(a, size_a), box_corners(b, size_b)
        low = [c.min(axis=axis) for c in corners]
        high = [c.max(axis=axis) for c in corners]
        sides = np.minimum(*high) - np.maximum(*low)
        common = np.where((sides < 0).any(axis=1), 0.0, sides.prod(axis=1))
        volumes = [(h - w).prod(axis=1) for h, w in zip(high, low, strict=True)]
    union = volumes[0] + volumes[1] - common
    return np.divide(common, union, out=np.zeros(len(a)), where=union > 0)
