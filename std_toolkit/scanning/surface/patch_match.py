"""PatchMatch: a slanted plane per pixel that correlates with neighbouring photos.

Source: Bleyer, Rhemann and Rother, "PatchMatch Stereo - Stereo Matching with Slanted Support
Windows", BMVC 2011; several views as in Galliani, Lasinger and Schindler, "Massively Parallel
Multiview Stereopsis by Surface Normal Diffusion", ICCV 2015.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.compiled import compiled

Map = NDArray[np.float32]


def match(
    grey: Map,
    others: Sequence[Map],
    K: Array,
    K_others: Array,
    T: Sequence[Any],
    corner: tuple[int, int],
    mask: NDArray[np.uint8],
    start: Map,
    normal: Map,
    given: tuple[Map, Map] | None,
    deepest: float,
    *,
    iterations: int,
    seed: int,
) -> tuple[Map, Map, Map, Map]:
    """Depth, normal, cost and contrast of the pixels in a window of a photo; see `DepthMap`.

    Args:
        grey, others: (H, W) grey values of the photo and of its neighbours.
        K, K_others: their (3, 3) intrinsics, (n, 3, 3) of the neighbours.
        T: motion from the photo's camera to each neighbour's.
        corner: top-left pixel (x, y) of the window.
        mask: (h, w) nonzero where depth is wanted.
        start, normal: (h, w) depth and (h, w, 3) normal of the hull.
        given: depth and normal to begin with; None: those of the hull, and random planes.
        deepest: largest depth below the hull, metres.
        iterations: number of passes over the window.
        seed: of the random planes.
    """
    mask, start = np.ascontiguousarray(mask), np.ascontiguousarray(start)
    normal = np.ascontiguousarray(normal)
    depth, turned = (start.copy(), normal.copy()) if given is None else given
    depth, turned = np.ascontiguousarray(depth), np.ascontiguousarray(turned)
    h = max(o.shape[0] for o in others)
    w = max(o.shape[1] for o in others)
    stack = np.zeros((len(others), h, w), np.float32)
    sizes = np.array([o.shape for o in others], dtype=np.int64)
    for i, o in enumerate(others):
        stack[i, : o.shape[0], : o.shape[1]] = o
    K_inverse = np.linalg.inv(K)
    A = np.stack([Ks @ t.R @ K_inverse for Ks, t in zip(K_others, T, strict=True)])
    b = np.stack([Ks @ t.t for Ks, t in zip(K_others, T, strict=True)])
    cost = np.full(depth.shape, 2, np.float32)
    contrast = np.zeros(depth.shape, np.float32)
    _patch_match(
        np.ascontiguousarray(grey), stack, sizes, K_inverse, A, b, corner[0], corner[1], mask,
        start, normal, depth, turned, cost, contrast, deepest, iterations, seed,
        given is None,
    )  # fmt: skip
    depth[cost > 1.5] = 0
    return depth, turned, cost, contrast


# Sums may be taken in any order; a division by zero is no error.
_fast = partial(compiled, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})


@_fast
def _window(grey, mask, x, y, cx, cy, du, dv, value):  # type: ignore[no-untyped-def]
    """Number, mean and variance of the grey values around a pixel of the mask; writes their
    offsets from it and their values less the mean."""
    h, w = mask.shape
    count = 0
    total = np.float32(0)
    for j in range(-5, 6, 2):
        for i in range(-5, 6, 2):
            ly, lx = y + j, x + i
            if ly < 0 or lx < 0 or ly >= h or lx >= w or mask[ly, lx] == 0:
                continue
            du[count] = i
            dv[count] = j
            value[count] = grey[ly + cy, lx + cx]
            total += value[count]
            count += 1
    mean = total / np.float32(max(count, 1))
    square = np.float32(0)
    for n in range(count):
        value[n] -= mean
        square += value[n] * value[n]
    return count, mean, square / np.float32(max(count, 1))


@_fast
def _plane_cost(  # type: ignore[no-untyped-def]
    stack, sizes, Ki, A, b, x, y, d, nx, ny, nz, count, mean, variance, du, dv, value, us, vs,
    costs, most,
):  # fmt: skip
    """Mean of 1 - NCC over the better half of the neighbours of a plane at pixel (x, y).

    It is 2 as soon as it cannot be below `most`.
    """
    if count < 12:
        return 2.0
    rx = Ki[0, 0] * x + Ki[0, 2]
    ry = Ki[1, 1] * y + Ki[1, 2]
    delta = d * (nx * rx + ny * ry + nz)
    if delta > -1e-6:
        return 2.0
    # X = K^-1 p / (n K^-1 p) * delta; m is the row n K^-1.
    inverse = 1.0 / delta
    m0 = nx * Ki[0, 0] * inverse
    m1 = ny * Ki[1, 1] * inverse
    m2 = (nx * Ki[0, 2] + ny * Ki[1, 2] + nz) * inverse
    good = 0
    views = stack.shape[0]
    for v in range(views):
        h00 = A[v, 0, 0] + b[v, 0] * m0
        h01 = A[v, 0, 1] + b[v, 0] * m1
        h10 = A[v, 1, 0] + b[v, 1] * m0
        h11 = A[v, 1, 1] + b[v, 1] * m1
        h20 = A[v, 2, 0] + b[v, 2] * m0
        h21 = A[v, 2, 1] + b[v, 2] * m1
        # The pixel itself; offsets from it are small, so single precision suffices for them.
        z = h20 * x + h21 * y + A[v, 2, 2] + b[v, 2] * m2
        if z - 5 * (abs(h20) + abs(h21)) <= 1e-9:
            continue
        g20, g21 = np.float32(h20 / z), np.float32(h21 / z)
        u0 = (h00 * x + h01 * y + A[v, 0, 2] + b[v, 0] * m2) / z
        v0 = (h10 * x + h11 * y + A[v, 1, 2] + b[v, 1] * m2) / z
        u, u_x, u_y = np.float32(u0), np.float32(h00 / z), np.float32(h01 / z)
        w, w_x, w_y = np.float32(v0), np.float32(h10 / z), np.float32(h11 / z)
        left, right, top, bottom = u, u, w, w
        for n in range(count):
            q = np.float32(1) / (np.float32(1) + g20 * du[n] + g21 * dv[n])
            us[n] = (u + u_x * du[n] + u_y * dv[n]) * q
            vs[n] = (w + w_x * du[n] + w_y * dv[n]) * q
            left, right = min(left, us[n]), max(right, us[n])
            top, bottom = min(top, vs[n]), max(bottom, vs[n])
        if left < 0 or top < 0 or right > sizes[v, 1] - 1.001 or bottom > sizes[v, 0] - 1.001:
            continue
        s1 = np.float32(0)
        s11 = np.float32(0)
        s01 = np.float32(0)
        for n in range(count):
            ix, iy = np.int32(us[n]), np.int32(vs[n])
            fx, fy = us[n] - np.float32(ix), vs[n] - np.float32(iy)
            o = stack[v, iy, ix] + fx * (stack[v, iy, ix + 1] - stack[v, iy, ix])
            p = stack[v, iy + 1, ix] + fx * (stack[v, iy + 1, ix + 1] - stack[v, iy + 1, ix])
            other = o + fy * (p - o) - mean
            s1 += other
            s11 += other * other
            s01 += other * value[n]
        s1 /= np.float32(count)
        variance1 = s11 / np.float32(count) - s1 * s1
        # One grey value of noise is added: flat windows correlate by chance.
        c = s01 / np.float32(count) / np.sqrt((variance + 1.0) * (variance1 + 1.0))
        # Sorted; the better half counts, at least two where there are two.
        k = good - 1
        while k >= 0 and costs[k] > 1 - c:
            costs[k + 1] = costs[k]
            k -= 1
        costs[k + 1] = 1 - c
        good += 1
        left_over = views - v - 1
        best = max(min(2, good + left_over), (good + left_over + 1) // 2)
        total = 0.0
        for n in range(best - left_over):
            total += costs[n]
        if total >= most * best:
            return 2.0
    if good == 0:
        return 2.0
    best = max(min(2, good), (good + 1) // 2)
    total = 0.0
    for n in range(best):
        total += costs[n]
    return total / best


@_fast
def _patch_match(  # type: ignore[no-untyped-def]
    grey, stack, sizes, Ki, A, b, cx, cy, mask, start, hull_normal, depth, normal, cost, contrast,
    deepest, iterations, seed, random_start,
) -> None:  # fmt: skip
    np.random.seed(seed)
    h, w = mask.shape
    du = np.empty(36, np.float32)
    dv = np.empty(36, np.float32)
    value = np.empty(36, np.float32)
    us = np.empty(36, np.float32)
    vs = np.empty(36, np.float32)
    costs = np.empty(32, np.float64)
    shallow = 0.06 * deepest
    for y in range(h):
        for x in range(w):
            if mask[y, x] == 0:
                depth[y, x] = 0
                continue
            n = normal[y, x]
            count, mean, variance = _window(grey, mask, x, y, cx, cy, du, dv, value)
            cost[y, x] = _plane_cost(
                stack, sizes, Ki, A, b, x + cx, y + cy, depth[y, x], n[0], n[1], n[2],
                count, mean, variance, du, dv, value, us, vs, costs, 2.0,
            )  # fmt: skip
            contrast[y, x] = np.sqrt(variance)
    for iteration in range(iterations):
        forward = iteration % 2 == 0
        step = 1 if forward else -1
        # Random steps shrink from the whole range to a fraction of a pixel.
        for yy in range(h):
            y = yy if forward else h - 1 - yy
            for xx in range(w):
                x = xx if forward else w - 1 - xx
                if mask[y, x] == 0:
                    continue
                count, mean, variance = _window(grey, mask, x, y, cx, cy, du, dv, value)
                rx = Ki[0, 0] * (x + cx) + Ki[0, 2]
                ry = Ki[1, 1] * (y + cy) + Ki[1, 2]
                low = start[y, x] - shallow
                high = start[y, x] + deepest
                steps = 4 if random_start else 3
                for k in range(4 + steps):
                    if k < 4:
                        # The plane of a pixel before this one.
                        far = -step if k < 2 else -5 * step
                        qx, qy = (x + far, y) if k % 2 == 0 else (x, y + far)
                        if qx < 0 or qy < 0 or qx >= w or qy >= h or mask[qy, qx] == 0:
                            continue
                        n0, n1, n2 = normal[qy, qx, 0], normal[qy, qx, 1], normal[qy, qx, 2]
                        ox = Ki[0, 0] * (qx + cx) + Ki[0, 2]
                        oy = Ki[1, 1] * (qy + cy) + Ki[1, 2]
                        bottom = n0 * rx + n1 * ry + n2
                        if bottom > -0.05:
                            continue
                        d = depth[qy, qx] * (n0 * ox + n1 * oy + n2) / bottom
                        same = n0 == normal[y, x, 0] and n1 == normal[y, x, 1]
                        if same and abs(d - depth[y, x]) < 1e-6 * d:
                            # It took this plane before.
                            continue
                    else:
                        if random_start and k == 4 and iteration < 3:
                            # Anywhere below the hull, near it more often.
                            d = low + (high - low) * np.random.random() ** 2
                            spread = 0.4
                            m = hull_normal[y, x]
                        else:
                            scale = 0.25 ** (k - 4 + (0 if random_start else 1))
                            d = depth[y, x] + (np.random.random() * 2 - 1) * 0.3 * deepest * scale
                            spread = 0.5 * scale + 0.02
                            m = normal[y, x]
                        n0 = m[0] + np.random.normal() * spread
                        n1 = m[1] + np.random.normal() * spread
                        n2 = m[2] + np.random.normal() * spread
                        size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + 1e-12
                        n0, n1, n2 = n0 / size, n1 / size, n2 / size
                        if n0 * rx + n1 * ry + n2 > -0.1:
                            continue
                    if d < low or d > high:
                        continue
                    c = _plane_cost(
                        stack, sizes, Ki, A, b, x + cx, y + cy, d, n0, n1, n2,
                        count, mean, variance, du, dv, value, us, vs, costs, cost[y, x],
                    )  # fmt: skip
                    if c < cost[y, x]:
                        cost[y, x] = c
                        depth[y, x] = d
                        normal[y, x, 0] = n0
                        normal[y, x, 1] = n1
                        normal[y, x, 2] = n2
