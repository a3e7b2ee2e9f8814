"""Depth of one camera drawn into the image of another, compiled.

Every depth pixel is drawn as a small patch of surface. One pass over the pixels takes about 20 ms
of one core at 1280x720, so that the writers of a recording keep up with the camera.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from std_toolkit.compiled import compiled
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.camera_models import largest_radius2
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]

# Neighbours whose depths differ by less are one surface: a wall seen at 80 degrees from its normal
# steps by 1.3 % from pixel to pixel at 640x360.
SURFACE_STEP = 0.02

# Patches overlap by this much, in pixels: between rotated cameras, rows of patches are slightly
# slanted, and a pixel centre could fall between two of them.
OVERLAP_PX = 0.02


def align_depth(
    depth: NDArray[np.floating],
    camera: Camera,
    other: Camera,
    T_other_depth: SE3,
) -> NDArray[np.float32]:
    """z-depth (H', W') float32 metres in `other`, 0 = none, of a depth image of `camera`.

    Every depth pixel becomes the patch of surface behind it. The patch covers the pixels of
    `other` whose centres are inside it; the nearest patch wins. Patches of one surface share their
    edges, so that a surface stays closed when it is magnified or seen obliquely. Nothing is
    filled: pixels without depth, and surfaces that the depth camera cannot see, stay empty.

    Args:
        depth: (H, W) metres, 0 = none.
        camera: intrinsics of the depth image.
        other: the target camera, such as the colour camera; it may have distortion.
        T_other_depth: maps points of the depth camera into the other one.

    Raises:
        ToolkitError: the image size differs from the camera's, or the depth contains negative or
            infinite values.
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
    splat(z, _patch_rays(camera), R, t, _lens(other), SURFACE_STEP, out)
    out[np.isinf(out)] = 0
    return out


@lru_cache(maxsize=4)
def _patch_rays(camera: Camera) -> tuple[Array, ...]:
    """x and y at z = 1 behind the pixels' edges, across and down, and behind their centres.

    Without distortion x depends only on the column and y only on the row: the arrays are then
    views of one row or column, which fit in the processor's cache.
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
            x, y = camera.pinhole_rays(across, down)
            arrays += [np.broadcast_to(x, shape), np.broadcast_to(y[:, None], shape)]
    return tuple(arrays)


@lru_cache(maxsize=16)
def _lens(camera: Camera) -> Array:
    """Intrinsics in the form that `splat` takes."""
    k = camera.opencv_distortion
    reach = largest_radius2(camera.distortion) if camera.is_distorted else np.inf
    bent = float(camera.is_distorted)
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *k, reach, bent])


@compiled
def splat(depth, rays, R, t, lens, surface_step, out):  # type: ignore[no-untyped-def]
    """Draw the patch of every depth pixel into `out`; the nearest patch at a pixel wins.

    A patch reaches to the middles of the edges to its four neighbours: midway in 1/z, which is
    linear over the image of a plane, where they are one surface; else at the pixel's own depth.

    Args:
        depth: (H, W) float64 metres, 0 = none.
        rays: six arrays, x and y at z = 1 behind the left edges of the pixels and the last column's
            right ones, (H, W + 1); likewise behind the upper edges and the last row's lower ones,
            (H + 1, W); and behind the pixel centres, (H, W).
        R, t: (3, 3), (3,) into the other camera.
        lens: (14,) fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, largest squared radius that the
            distortion reaches, and 1 if there is any distortion.
        surface_step: neighbours whose depths differ by a smaller share are one surface.
        out: (H', W') float32, changed in place; infinite where there is no surface.
    """
    across_x, across_y, down_x, down_y, centre_x, centre_y = rays
    rows, columns = depth.shape
    height, width = out.shape
    # Two pixels of one surface share the edge between them: it is projected once.
    above = np.empty(columns)
    for v in range(rows):
        beside = 0.0
        for u in range(columns):
            z = depth[v, u]
            if z <= 0:
                continue
            x, y = centre_x[v, u], centre_y[v, u]
            middle = (R[2, 0] * x + R[2, 1] * y + R[2, 2]) * z + t[2]
            if u > 0 and _joined(z, depth[v, u - 1], surface_step):
                a = beside
            else:
                a, _ = _pixel(across_x[v, u], across_y[v, u], z, R, t, lens)
            if v > 0 and _joined(z, depth[v - 1, u], surface_step):
                c = above[u]
            else:
                _, c = _pixel(down_x[v, u], down_y[v, u], z, R, t, lens)
            right = _edge(z, depth[v, u + 1] if u + 1 < columns else 0.0, surface_step)
            lower = _edge(z, depth[v + 1, u] if v + 1 < rows else 0.0, surface_step)
            b, _ = _pixel(across_x[v, u + 1], across_y[v, u + 1], right, R, t, lens)
            _, d = _pixel(down_x[v + 1, u], down_y[v + 1, u], lower, R, t, lens)
            beside, above[u] = b, d
            # Behind the other camera, or beyond the reach of the distortion's polynomial.
            if not (middle > 0 and np.isfinite(a + b + c + d)):
                continue
            x0 = int(np.ceil(max(min(a, b) - OVERLAP_PX, 0.0)))
            x1 = int(np.floor(min(max(a, b) + OVERLAP_PX, width - 1.0)))
            y0 = int(np.ceil(max(min(c, d) - OVERLAP_PX, 0.0)))
            y1 = int(np.floor(min(max(c, d) + OVERLAP_PX, height - 1.0)))
            near = np.float32(middle)
            for j in range(y0, y1 + 1):
                for i in range(x0, x1 + 1):
                    if near < out[j, i]:
                        out[j, i] = near


@compiled
def _joined(z, beside, surface_step):  # type: ignore[no-untyped-def]
    """Whether neighbours of these depths are one surface."""
    return beside > 0 and abs(beside - z) < surface_step * min(z, beside)


@compiled
def _edge(z, beside, surface_step):  # type: ignore[no-untyped-def]
    """Depth at the edge between a pixel of depth `z` and its neighbour of depth `beside`."""
    if _joined(z, beside, surface_step):
        return 2 * z * beside / (z + beside)
    return z


@compiled
def _pixel(x, y, z, R, t, lens):  # type: ignore[no-untyped-def]
    """Pixel in the other camera of the point z * (x, y, 1); NaN where there is none."""
    X = (R[0, 0] * x + R[0, 1] * y + R[0, 2]) * z + t[0]
    Y = (R[1, 0] * x + R[1, 1] * y + R[1, 2]) * z + t[1]
    Z = (R[2, 0] * x + R[2, 1] * y + R[2, 2]) * z + t[2]
    if Z <= 0:
        return np.nan, np.nan
    inverse = 1.0 / Z
    x, y = X * inverse, Y * inverse
    if lens[13] != 0:
        r2 = x * x + y * y
        if not r2 < lens[12]:
            return np.nan, np.nan
        top = 1 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        radial = top / (1 + r2 * (lens[9] + r2 * (lens[10] + r2 * lens[11])))
        bent_x = x * radial + 2 * lens[6] * x * y + lens[7] * (r2 + 2 * x * x)
        bent_y = y * radial + lens[6] * (r2 + 2 * y * y) + 2 * lens[7] * x * y
        x, y = bent_x, bent_y
    return lens[0] * x + lens[2], lens[1] * y + lens[3]
