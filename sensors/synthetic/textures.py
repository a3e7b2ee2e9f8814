"""Printed-looking random textures, and how they wrap around objects."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
_WORDS = ("OATS", "SOUP", "250 g", "net", "fresh", "A4", "lab", "42", "cocoa", "R&D", "NEW", "mix")


def printed_texture(
    rng: np.random.Generator,
    *,
    width: int,
    height: int,
    base: tuple[float, float, float],
    marks: int,
    contrast: float = 1.0,
    mark_size: tuple[float, float] = (0.02, 0.1),
) -> Image:
    """(height, width, 3) float32 RGB in [0, 1]: a paper colour with shapes, words and grain.

    Args:
        base: colour of the ground.
        marks: number of shapes and words.
        contrast: 1 prints in any colour, 0 in the ground's.
        mark_size: extent of the marks as a share of the shorter side.
    """
    image = np.empty((height, width, 3), np.uint8)
    image[:] = np.rint(np.asarray(base) * 255)
    size = min(width, height)
    for _ in range(marks):
        ink = rng.uniform(0.05, 0.95, 3)
        # Most prints are near grey; a table of saturated colours would hide every object.
        ink = ink.mean() + 0.45 * (ink - ink.mean())
        colour = tuple(int(255 * x) for x in np.asarray(base) + contrast * (ink - base))
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        extent = size * float(rng.uniform(*mark_size))
        kind = rng.integers(4)
        if kind == 0:
            cv2.circle(image, (x, y), int(extent), colour, -1, cv2.LINE_AA)
        elif kind == 1:
            w, h = extent * rng.uniform(0.4, 2, 2)
            corners = cv2.boxPoints(((x, y), (w, h), float(rng.uniform(0, 180))))
            cv2.fillConvexPoly(image, corners.astype(np.int32), colour, cv2.LINE_AA)
        elif kind == 2:
            end = (x + int(rng.uniform(-2, 2) * extent), y + int(rng.uniform(-2, 2) * extent))
            thick = max(1, int(extent * 0.15))
            cv2.line(image, (x, y), end, colour, thick, cv2.LINE_AA)
        else:
            word = _WORDS[rng.integers(len(_WORDS))]
            scale = max(0.3, extent / 22)
            cv2.putText(
                image, word, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA
            )
    grain = sum(
        cv2.resize(
            rng.normal(0, 0.045, (height // step + 1, width // step + 1)).astype(np.float32),
            (width, height),
            interpolation=cv2.INTER_CUBIC,
        )
        for step in (2, 5, 14, 60)
    )
    printed = image.astype(np.float32) / 255 + np.asarray(grain, dtype=np.float32)[..., None]
    return np.clip(printed, 0.02, 0.98)


def sample(texture: Image, u: NDArray[np.floating], v: NDArray[np.floating]) -> Image:
    """(N, 3) colours at texture coordinates u, v (N,) in [0, 1], bilinear, wrapped around."""
    height, width = texture.shape[:2]
    x = (np.mod(u, 1) * width).astype(np.float32)
    y = (np.mod(v, 1) * height).astype(np.float32)
    # OpenCV's remap takes at most 32767 columns: fold the list into rows.
    count = len(x)
    columns = 4096
    rows = -(-count // columns)
    grid = np.zeros((2, rows * columns), np.float32)
    grid[0, :count], grid[1, :count] = x, y
    map_x, map_y = grid.reshape(2, rows, columns)
    out = cv2.remap(texture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(out, dtype=np.float32).reshape(-1, 3)[:count]


def wrap(
    points: NDArray[np.floating], normals: NDArray[np.floating], extents: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Texture coordinates of surface points (N, 3) of a centred object: one print per side.

    Each of the six directions that a normal can face most gets its own tile of the texture.
    """
    axis = np.argmax(np.abs(normals), axis=1)
    other = np.array([[2, 1], [0, 2], [0, 1]])[axis]
    rows = np.arange(len(points))
    side = 2 * axis + (normals[rows, axis] > 0)
    a = points[rows, other[:, 0]] / extents.max() + 0.5
    b = points[rows, other[:, 1]] / extents.max() + 0.5
    return (a + side % 3) / 3, (1 - b + side // 3) / 2
