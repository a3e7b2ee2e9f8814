"""A depth image as another camera beside it would have measured it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sensors.align.splat import splat
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]
# Neighbours whose depths differ by less are one surface: a wall seen at 80 degrees from its normal
# steps by 1.3 % from pixel to pixel at 640x360.
SURFACE_STEP = 0.02
# Edges of the patch behind a pixel: its left, right, upper and lower neighbour.
_SIDES = ((-1, 0), (1, 0), (0, -1), (0, 1))


def align_depth(
    depth: NDArray[np.floating],
    camera: Camera,
    other: Camera,
    T_other_depth: SE3,
    *,
    surface_step: float = SURFACE_STEP,
) -> NDArray[np.float32]:
    """z-depth (H', W') float32 metres in `other`, 0 = none, of a depth image of `camera`.

    Every depth pixel becomes the patch of surface behind it. The patch covers those pixels of
    `other` whose centres it holds, and the nearest one wins. Patches of one surface share their
    edges, so that a surface stays closed when it is enlarged or seen from the side. Nothing is
    filled in: what has no depth, and what the depth camera cannot see behind an edge, stays empty.

    Args:
        depth: (H, W) metres, 0 = none.
        camera: of the depth image.
        other: such as the colour camera; it may have distortion.
        T_other_depth: maps points of the depth camera into the other one.
        surface_step: neighbours whose depths differ by a smaller share are one surface.

    Raises:
        ToolkitError: the image has another size than its camera, or holds negative or infinite
            depth.
    """
    if depth.shape != (camera.height, camera.width):
        raise ToolkitError(
            f"depth has another size than its camera, {camera.width}x{camera.height}",
            field="depth",
            value=depth.shape,
        )
    z = np.asarray(depth, dtype=np.float64)
    if not np.isfinite(z).all() or (z < 0).any():
        raise ToolkitError("depth holds negative or infinite values", field="depth")
    seen = z > 0
    edges = [
        _moved(_edge_rays(camera, side), _edge_depth(z, side, surface_step), T_other_depth)
        for side in _SIDES
    ]
    R, t = T_other_depth.R, T_other_depth.t
    centre = z * (_centre_rays(camera) @ R[2]) + t[2]
    seen &= centre > 0
    for points in edges:
        seen &= points[..., 2] > 0
    spans = []
    for (first, second), axis in (((0, 1), 0), ((2, 3), 1)):
        a = other.project(edges[first][seen])[:, axis]
        b = other.project(edges[second][seen])[:, axis]
        spans += [np.minimum(a, b), np.maximum(a, b)]
    patches = np.stack(spans, axis=1)
    inside = np.isfinite(patches).all(axis=1)  # beyond the reach of the distortion's polynomial
    out = np.full((other.height, other.width), np.inf, dtype=np.float32)
    splat(patches[inside], centre[seen][inside].astype(np.float32), out)
    out[np.isinf(out)] = 0
    return out


def _edge_depth(z: Array, side: tuple[int, int], surface_step: float) -> Array:
    """Depth at an edge of each pixel's patch: midway to the neighbour on the same surface.

    Midway in 1/z, which is linear over the image of a plane.
    """
    dx, dy = side
    beside = np.zeros_like(z)
    height, width = z.shape
    to = np.s_[max(0, -dy) : height - max(0, dy), max(0, -dx) : width - max(0, dx)]
    of = np.s_[max(0, dy) : height - max(0, -dy), max(0, dx) : width - max(0, -dx)]
    beside[to] = z[of]
    joined = (z > 0) & (beside > 0) & (abs(beside - z) < surface_step * np.minimum(z, beside))
    total = np.where(joined, z + beside, 1)
    return np.where(joined, 2 * z * beside / total, z)


def _moved(rays: Array, z: Array, T: SE3) -> Array:
    """(H, W, 3) points at depth z on the rays, in the other camera."""
    return (rays @ T.R.T) * z[..., None] + T.t


@lru_cache(maxsize=16)
def _edge_rays(camera: Camera, side: tuple[int, int]) -> Array:
    rays = camera.unproject(camera.pixel_grid() + np.array(side) / 2)
    rays.flags.writeable = False
    return rays


@lru_cache(maxsize=4)
def _centre_rays(camera: Camera) -> Array:
    rays = camera.unproject(camera.pixel_grid())
    rays.flags.writeable = False
    return rays
