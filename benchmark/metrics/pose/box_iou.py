"""Intersection over union of two boxes in space, in the three definitions of the field."""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.pose.boxes import box_corners, cube_to_box, turned_about_y
from benchmark.metrics.pose.intersection import common_volume
from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]


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
