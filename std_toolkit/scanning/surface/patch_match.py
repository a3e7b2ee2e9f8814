"""PatchMatch: a slanted plane per pixel that correlates with neighbouring photos.

Source: Bleyer, Rhemann and Rother, "PatchMatch Stereo - Stereo Matching with Slanted Support
Windows", BMVC 2011; several views as in Galliani, Lasinger and Schindler, "Massively Parallel
Multiview Stereopsis by Surface Normal Diffusion", ICCV 2015.
"""

from collections.abc import Sequence
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


@compiled
def _plane_cost(  # type: ignore[no-untyped-def]
    grey, stack, sizes, Ki, A, b, x, y, cx, cy, mask, d, nx, ny, nz, samples, costs
):
    """Mean of 1 - NCC over the better half of the neighbours of a plane at pixel (x, y)."""
    rx = Ki[0, 0] * x + Ki[0, 2]
    ry = Ki[1, 1] * y + Ki[1, 2]
    delta = d * (nx * rx + ny * ry + nz)
    if delta > -1e-6:
        return 2.0
    # X = K^-1 p / (n K^-1 p) * delta; m is the row n K^-1.
    m0 = nx * Ki[0, 0]
    m1 = ny * Ki[1, 1]
    m2 = nx * Ki[0, 2] + ny * Ki[1, 2] + nz
    inverse = 1.0 / delta
    # The window holds grey values of the reference photo: sum, square sum and count.
    count = 0
    s0 = 0.0
    s00 = 0.0
    h, w = mask.shape
    for j in range(-5, 6, 2):
        for i in range(-5, 6, 2):
            px, py = x + i, y + j
            ly, lx = py - cy, px - cx
            if ly < 0 or lx < 0 or ly >= h or lx >= w or mask[ly, lx] == 0:
                continue
            g = grey[py, px]
            samples[count, 0] = px
            samples[count, 1] = py
            samples[count, 2] = g
            s0 += g
            s00 += g * g
            count += 1
    if count < 12:
        return 2.0
    mean0 = s0 / count
    var0 = s00 / count - mean0 * mean0
    good = 0
    for v in range(stack.shape[0]):
        h00 = A[v, 0, 0] + b[v, 0] * m0 * inverse
        h01 = A[v, 0, 1] + b[v, 0] * m1 * inverse
        h02 = A[v, 0, 2] + b[v, 0] * m2 * inverse
        h10 = A[v, 1, 0] + b[v, 1] * m0 * inverse
        h11 = A[v, 1, 1] + b[v, 1] * m1 * inverse
        h12 = A[v, 1, 2] + b[v, 1] * m2 * inverse
        h20 = A[v, 2, 0] + b[v, 2] * m0 * inverse
        h21 = A[v, 2, 1] + b[v, 2] * m1 * inverse
        h22 = A[v, 2, 2] + b[v, 2] * m2 * inverse
        s1 = 0.0
        s11 = 0.0
        s01 = 0.0
        inside = True
        top, right = sizes[v, 0] - 1.001, sizes[v, 1] - 1.001
        for n in range(count):
            px, py, g = samples[n, 0], samples[n, 1], samples[n, 2]
            q = h20 * px + h21 * py + h22
            if q <= 1e-9:
                inside = False
                break
            q = 1.0 / q
            sx = (h00 * px + h01 * py + h02) * q
            sy = (h10 * px + h11 * py + h12) * q
            if sx < 0 or sy < 0 or sx > right or sy > top:
                inside = False
                break
            ix, iy = int(sx), int(sy)
            fx, fy = sx - ix, sy - iy
            o = stack[v, iy, ix] * (1 - fx) + stack[v, iy, ix + 1] * fx
            p = stack[v, iy + 1, ix] * (1 - fx) + stack[v, iy + 1, ix + 1] * fx
            value = o + fy * (p - o)
            s1 += value
            s11 += value * value
            s01 += value * g
        if not inside:
            continue
        mean1 = s1 / count
        var1 = s11 / count - mean1 * mean1
        # One grey value of noise is added: flat windows correlate by chance.
        c = (s01 / count - mean0 * mean1) / np.sqrt((var0 + 1.0) * (var1 + 1.0))
        costs[good] = 1 - c
        good += 1
    if good == 0:
        return 2.0
    # Insertion sort; the better half counts, at least two where there are two.
    for n in range(1, good):
        value = costs[n]
        k = n - 1
        while k >= 0 and costs[k] > value:
            costs[k + 1] = costs[k]
            k -= 1
        costs[k + 1] = value
    best = max(min(2, good), (good + 1) // 2)
    total = 0.0
    for n in range(best):
        total += costs[n]
    return total / best


@compiled
def _keep_better(  # type: ignore[no-untyped-def]
    grey, stack, sizes, Ki, A, b, x, y, cx, cy, mask, d, n0, n1, n2, samples, costs, depth, normal,
    cost,
) -> None:  # fmt: skip
    """Give a pixel the plane of depth d and normal n if it costs less than its own."""
    c = _plane_cost(
        grey, stack, sizes, Ki, A, b, x + cx, y + cy, cx, cy, mask, d, n0, n1, n2, samples, costs
    )
    if c < cost[y, x]:
        cost[y, x] = c
        depth[y, x] = d
        normal[y, x, 0] = n0
        normal[y, x, 1] = n1
        normal[y, x, 2] = n2


@compiled
def _patch_match(  # type: ignore[no-untyped-def]
    grey, stack, sizes, Ki, A, b, cx, cy, mask, start, hull_normal, depth, normal, cost, contrast,
    deepest, iterations, seed, random_start,
) -> None:  # fmt: skip
    np.random.seed(seed)
    h, w = mask.shape
    samples = np.empty((36, 3), np.float64)
    costs = np.empty(32, np.float64)
    shallow = 0.06 * deepest
    for y in range(h):
        for x in range(w):
            if mask[y, x] == 0:
                depth[y, x] = 0
                continue
            n = normal[y, x]
            cost[y, x] = _plane_cost(
                grey, stack, sizes, Ki, A, b, x + cx, y + cy, cx, cy, mask, depth[y, x],
                n[0], n[1], n[2], samples, costs,
            )  # fmt: skip
            s0 = 0.0
            s00 = 0.0
            count = 0
            for j in range(max(0, y - 5), min(h, y + 6), 2):
                for i in range(max(0, x - 5), min(w, x + 6), 2):
                    if mask[j, i]:
                        g = grey[j + cy, i + cx]
                        s0 += g
                        s00 += g * g
                        count += 1
            if count > 0:
                contrast[y, x] = np.sqrt(max(0.0, s00 / count - (s0 / count) ** 2))
    for iteration in range(iterations):
        forward = iteration % 2 == 0
        # Random steps shrink from the whole range to a fraction of a pixel.
        for yy in range(h):
            y = yy if forward else h - 1 - yy
            for xx in range(w):
                x = xx if forward else w - 1 - xx
                if mask[y, x] == 0:
                    continue
                rx = Ki[0, 0] * (x + cx) + Ki[0, 2]
                ry = Ki[1, 1] * (y + cy) + Ki[1, 2]
                low = start[y, x] - shallow
                high = start[y, x] + deepest
                # Planes of the pixels before this one.
                for k in range(4):
                    dx, dy = 0, 0
                    if k == 0:
                        dx = -1 if forward else 1
                    elif k == 1:
                        dy = -1 if forward else 1
                    elif k == 2:
                        dx = -5 if forward else 5
                    else:
                        dy = -5 if forward else 5
                    qx, qy = x + dx, y + dy
                    if qx < 0 or qy < 0 or qx >= w or qy >= h or mask[qy, qx] == 0:
                        continue
                    n0, n1, n2 = normal[qy, qx, 0], normal[qy, qx, 1], normal[qy, qx, 2]
                    ox = Ki[0, 0] * (qx + cx) + Ki[0, 2]
                    oy = Ki[1, 1] * (qy + cy) + Ki[1, 2]
                    bottom = n0 * rx + n1 * ry + n2
                    if bottom > -0.05:
                        continue
                    d = depth[qy, qx] * (n0 * ox + n1 * oy + n2) / bottom
                    if d < low or d > high:
                        continue
                    _keep_better(
                        grey, stack, sizes, Ki, A, b, x, y, cx, cy, mask, d, n0, n1, n2,
                        samples, costs, depth, normal, cost,
                    )  # fmt: skip
                steps = 4 if random_start else 3
                for k in range(steps):
                    if random_start and k == 0 and iteration < 3:
                        # Anywhere below the hull, near it more often.
                        d = low + (high - low) * np.random.random() ** 2
                        spread = 0.4
                        n0, n1, n2 = (
                            hull_normal[y, x, 0],
                            hull_normal[y, x, 1],
                            hull_normal[y, x, 2],
                        )
                    else:
                        scale = 0.25 ** (k + (0 if random_start else 1))
                        d = depth[y, x] + (np.random.random() * 2 - 1) * 0.3 * deepest * scale
                        spread = 0.5 * scale + 0.02
                        n0, n1, n2 = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
                    if d < low or d > high:
                        continue
                    n0 += np.random.normal() * spread
                    n1 += np.random.normal() * spread
                    n2 += np.random.normal() * spread
                    size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + 1e-12
                    n0, n1, n2 = n0 / size, n1 / size, n2 / size
                    if n0 * rx + n1 * ry + n2 > -0.1:
                        continue
                    _keep_better(
                        grey, stack, sizes, Ki, A, b, x, y, cx, cy, mask, d, n0, n1, n2,
                        samples, costs, depth, normal, cost,
                    )  # fmt: skip
