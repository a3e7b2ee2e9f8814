"""Views whose depth is known by formula."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions, make_restorer
from std_toolkit.geometry.camera import Camera, pixel_rays

FILLINGS = ("nearest", "navier-stokes", "telea", "joint-bilateral", "colorization", "planes")
CAMERA = Camera(160, 120, 180.0, 185.0, 81.0, 58.0)


def plane_depth(normal: tuple[float, float, float], offset: float) -> NDArray[np.float64]:
    """(h, w) depth of the plane n . p = offset."""
    return offset / (pixel_rays(CAMERA) @ np.array(normal))


def grey(level: int = 128) -> NDArray[np.uint8]:
    return np.full((CAMERA.height, CAMERA.width, 3), level, dtype=np.uint8)


def disc(row: float, column: float, radius: float) -> NDArray[np.bool_]:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return np.asarray((v - row) ** 2 + (u - column) ** 2 < radius**2)


def view_of(
    depth: NDArray[np.floating],
    hidden: NDArray[np.bool_],
    color: NDArray[np.uint8] | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> View:
    """A view that does not see the depth of the hidden pixels."""
    seen = np.where(hidden, 0, depth).astype(np.float32)
    return View(grey() if color is None else color, seen, CAMERA, mask)


def restored(method: str, view: View, **settings: str) -> NDArray[np.float32]:
    return make_restorer(method, MethodOptions(settings=settings)).restore([view])[0].depth


def two_walls() -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """A near red wall on the left and a far blue one on the right, which meet in column 80."""
    left = np.arange(CAMERA.width) < 80
    depth = np.broadcast_to(np.where(left, 0.5, 1.5), (CAMERA.height, CAMERA.width)).copy()
    color = np.where(left[None, :, None], (200, 40, 30), (20, 60, 190)).astype(np.uint8)
    return depth, np.broadcast_to(color, (*depth.shape, 3)).copy()
