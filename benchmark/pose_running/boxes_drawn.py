"""Boxes and axes of objects, drawn on an image: true ones green, estimated ones red."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.pose.boxes import box_corners
from std_toolkit.geometry.camera import Camera

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]
RGB = tuple[int, int, int]

TRUE_COLOR: RGB = (20, 205, 75)
ESTIMATE_COLOR: RGB = (235, 45, 40)
# Lines are drawn with so many bits behind the point.
_SHIFT = 4
_NEAREST_M = 0.05
# Corners of a box that differ in one sign: its edges.
_EDGES = tuple((a, b) for a, b in combinations(range(8), 2) if bin(a ^ b).count("1") == 1)


def draw_boxes(
    image: Image, camera: Camera, RT: Floats, sizes: Floats, color: RGB, *, width: int = 2
) -> None:
    """Draw boxes and, from the middle of each, the half axis that points up and the two others.

    Args:
        image: (h, w, 3) uint8 RGB of the camera's size; it is drawn on.
        camera: of the image.
        RT: (N, 4, 4) object to camera, the scale inside.
        sizes: (N, 3) of the boxes before RT.
        color: of the lines.
        width: of the lines, pixels. The up axis is twice as wide.
    """
    for T, size in zip(RT, sizes, strict=True):
        corners = box_corners(T, size).T
        lines: list[tuple[Floats, Floats, int]] = [
            (corners[a], corners[b], width) for a, b in _EDGES
        ]
        centre = T[:3, 3]
        for axis, wide in ((0, width), (2, width), (1, 2 * width)):
            lines.append((centre, centre + T[:3, axis] * size[axis] / 2, wide))
        _draw(image, camera, lines, color)


def _draw(
    image: Image, camera: Camera, lines: Sequence[tuple[Floats, Floats, int]], color: RGB
) -> None:
    pieces = [(*ends, wide) for a, b, wide in lines if (ends := _in_front(a, b)) is not None]
    drawn = [
        (*(np.rint(camera.project(p) * 2**_SHIFT).astype(int).tolist() for p in (a, b)), wide)
        for a, b, wide in pieces
    ]
    for a, b, wide in drawn:
        if max(abs(x) for x in (*a, *b)) < 2**20:
            cv2.line(image, a, b, color, wide, cv2.LINE_AA, _SHIFT)


def _in_front(a: Floats, b: Floats) -> tuple[Floats, Floats] | None:
    """The part of a line that lies in front of the camera; None if none does."""
    near = _NEAREST_M
    if a[2] < near and b[2] < near:
        return None
    if a[2] < near:
        a = a + (b - a) * (near - a[2]) / (b[2] - a[2])
    elif b[2] < near:
        b = b + (a - b) * (near - b[2]) / (a[2] - b[2])
    return a, b
