"""A depth image as another camera beside it would have measured it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sensors.align.splat import splat
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, largest_radius2
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]
# Neighbours whose depths differ by less are one surface: a wall seen at 80 degrees from its normal
# steps by 1.3 % from pixel to pixel at 640x360.
SURFACE_STEP = 0.02


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
    z = np.ascontiguousarray(depth, dtype=np.float64)
    if not np.isfinite(z).all() or (z < 0).any():
        raise ToolkitError("depth holds negative or infinite values", field="depth")
    R, t = np.ascontiguousarray(T_other_depth.R), np.ascontiguousarray(T_other_depth.t)
    out = np.full((other.height, other.width), np.inf, dtype=np.float32)
    splat(z, _patch_rays(camera), R, t, _lens(other), surface_step, out)
    out[np.isinf(out)] = 0
    return out


@lru_cache(maxsize=4)
def _patch_rays(camera: Camera) -> tuple[Array, ...]:
    """x and y at z = 1 behind the pixels' edges, across and down, and behind their centres.

    Without distortion x depends on the column and y on the row alone: the arrays then are views
    of one row or column, which stay in the processor's cache.
    """
    u, v = np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64)
    edges_u = np.arange(camera.width + 1, dtype=np.float64) - 0.5
    edges_v = np.arange(camera.height + 1, dtype=np.float64) - 0.5
    arrays: list[Array] = []
    for across, down in ((edges_u, v), (u, edges_v), (u, v)):
        shape = (len(down), len(across))
        if camera.is_distorted:
            rays = camera.unproject(np.stack(np.meshgrid(across, down), axis=-1))
            arrays += [np.ascontiguousarray(rays[..., 0]), np.ascontiguousarray(rays[..., 1])]
        else:
            x = (across - camera.cx) / camera.fx
            y = (down - camera.cy) / camera.fy
            arrays += [np.broadcast_to(x, shape), np.broadcast_to(y[:, None], shape)]
    return tuple(arrays)


@lru_cache(maxsize=16)
def _lens(camera: Camera) -> Array:
    """Intrinsics as `splat` takes them."""
    k = (*camera.distortion, *([0.0] * (8 - len(camera.distortion))))
    reach = largest_radius2(camera.distortion) if camera.is_distorted else np.inf
    bent = float(camera.is_distorted)
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *k, reach, bent])
