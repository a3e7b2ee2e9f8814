"""The local matcher on the CPU: bands of rows over threads of compiled code.

Includes compiled filters of a disparity map with holes.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sensors.stereo import numba_kernels
from sensors.stereo.local_options import Cost, LocalMatcherOptions, Subpixel, window_sums
from sensors.stereo.stereo_matcher import Disparity, Image
from std_toolkit.compiled import compiled

# Rows of a band: few enough that its costs (10 MB for 100 disparities of 640 columns) are
# cheap, many enough that few rows are shared with the neighbouring bands.
BAND_ROWS = 45

CURVES = {
    Subpixel.QUADRATIC: numba_kernels.QUADRATIC,
    Subpixel.EQUIANGULAR: numba_kernels.EQUIANGULAR,
    Subpixel.GAUSSIAN: numba_kernels.GAUSSIAN,
    Subpixel.NONE: numba_kernels.NONE,
}

Rows = Callable[[int, int, NDArray[np.unsignedinteger]], None]


def match(left: Image, right: Image, options: LocalMatcherOptions, threads: int) -> Disparity:
    """See `LocalMatcher.match`. Uses Python threads: numba's may not survive a fork."""
    height, width = left.shape
    bands = list(pairwise([*range(0, height, BAND_ROWS), height]))
    with ThreadPoolExecutor(threads) as pool:
        cost_rows = _cost_rows(left, right, options, pool, bands)
        found = np.zeros((height, width), dtype=np.float32)
        radius = options.aggregation_px // 2
        # 48 bits differ at most, in 21x21 pixels: the sums of a census fit 16 bits.
        is_census = options.cost is Cost.CENSUS
        cost_type = np.uint8 if is_census else np.uint16
        sum_of = np.empty(0, np.uint16 if is_census else np.int32)

        def band_winners(band: tuple[int, int]) -> None:
            y0, y1 = band
            top, bottom = max(0, y0 - radius), min(height, y1 + radius)
            costs = np.empty((bottom - top, width, options.count), dtype=cost_type)
            cost_rows(top, bottom, costs)
            numba_kernels.winners(
                costs, sum_of, top, y0, y1, height, radius, options.min_disparity,
                options.uniqueness_percent,
                -1 if options.left_right_px is None else options.left_right_px,
                CURVES[options.curve],
                options.gaussian_foot,
                found,
            )  # fmt: skip

        list(pool.map(band_winners, bands))
        side = options.median_px
        if side > 1:
            smooth = np.empty_like(found)
            list(pool.map(lambda band: median_rows(found, side, band[0], band[1], smooth), bands))
            found = smooth
    if options.speckle_px > 1:
        step = np.float32(options.speckle_step_px)
        remove_speckles(found, options.speckle_px, step)
    return found


def continued(image: Image, radius: int) -> Image:
    """The image padded by its border pixels."""
    return np.pad(image, radius, mode="edge")


def _cost_rows(
    left: Image,
    right: Image,
    options: LocalMatcherOptions,
    pool: ThreadPoolExecutor,
    bands: list[tuple[int, int]],
) -> Rows:
    """A function that computes the costs of some rows."""
    d0 = options.min_disparity
    if options.cost is Cost.CENSUS:
        a, b = (_census(image, pool, bands) for image in (left, right))
        return lambda y0, y1, out: numba_kernels.census_rows(a, b, d0, y0, y1, out)
    size = options.zncc_px
    a, b = (continued(image, size // 2) for image in (left, right))
    (l_sum, l_inv), (r_sum, r_inv) = window_sums(a, size), window_sums(b, size)
    return lambda y0, y1, out: numba_kernels.zncc_rows(
        a, b, l_sum, r_sum, l_inv, r_inv, size, d0, y0, y1, out
    )


def _census(
    image: Image, pool: ThreadPoolExecutor, bands: list[tuple[int, int]]
) -> NDArray[np.generic]:
    padded = continued(image, numba_kernels.CENSUS_RADIUS)
    out = np.empty(image.shape, dtype=np.uint64)
    list(pool.map(lambda band: numba_kernels.census(padded, band[0], band[1], out), bands))
    return out


@compiled
def _median_of_nine(a):  # type: ignore[no-untyped-def]
    """The least value and the median of a 3x3 array, by sorting its columns and diagonals."""
    low0, mid0, top0 = _sorted(a[0, 0], a[1, 0], a[2, 0])
    low1, mid1, top1 = _sorted(a[0, 1], a[1, 1], a[2, 1])
    low2, mid2, top2 = _sorted(a[0, 2], a[1, 2], a[2, 2])
    least = min(low0, min(low1, low2))
    _, middle, _ = _sorted(mid0, mid1, mid2)
    _, middle, _ = _sorted(max(low0, max(low1, low2)), middle, min(top0, min(top1, top2)))
    return least, middle


@compiled
def _sorted(a, b, c):  # type: ignore[no-untyped-def]
    low, high = min(a, b), max(a, b)
    return min(low, c), max(low, min(high, c)), max(high, c)


@compiled
def median_rows(disparity, side, y0, y1, out):  # type: ignore[no-untyped-def]
    """Rows y0..y1: the (lower) median of the valid pixels around each valid pixel.

    Holes stay holes: their disparity is 0 and is ignored.
    """
    height, width = disparity.shape
    radius = side // 2
    values = np.empty(side * side, dtype=np.float32)
    for y in range(y0, y1):
        for x in range(width):
            if disparity[y, x] == 0:
                out[y, x] = 0
                continue
            if side == 3 and 0 < y < height - 1 and 0 < x < width - 1:
                around = disparity[y - 1 : y + 2, x - 1 : x + 2]
                least, middle = _median_of_nine(around)
                if least > 0:
                    out[y, x] = middle
                    continue
            count = 0
            for v in range(max(0, y - radius), min(height, y + radius + 1)):
                for u in range(max(0, x - radius), min(width, x + radius + 1)):
                    value = disparity[v, u]
                    if value == 0:
                        continue
                    place = count
                    while place > 0 and values[place - 1] > value:
                        values[place] = values[place - 1]
                        place -= 1
                    values[place] = value
                    count += 1
            out[y, x] = values[(count - 1) // 2]


@compiled
def remove_speckles(disparity, smallest, step):  # type: ignore[no-untyped-def]
    """Clear, in place, connected patches of fewer than `smallest` valid pixels.

    Two of four neighbours are connected if they differ by at most `step`.
    """
    height, width = disparity.shape
    parent = np.arange(height * width)
    for y in range(height):
        for x in range(width):
            here = disparity[y, x]
            if here == 0:
                continue
            i = y * width + x
            if x > 0 and disparity[y, x - 1] != 0 and abs(disparity[y, x - 1] - here) <= step:
                _join(parent, i, i - 1)
            if y > 0 and disparity[y - 1, x] != 0 and abs(disparity[y - 1, x] - here) <= step:
                _join(parent, i, i - width)
    size = np.zeros(height * width, dtype=np.int64)
    for i in range(height * width):
        parent[i] = _root(parent, i)
        size[parent[i]] += 1
    for y in range(height):
        for x in range(width):
            if size[parent[y * width + x]] < smallest:
                disparity[y, x] = 0


@compiled
def _root(parent, i):  # type: ignore[no-untyped-def]
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled
def _join(parent, i, j):  # type: ignore[no-untyped-def]
    i, j = _root(parent, i), _root(parent, j)
    if i != j:
        parent[max(i, j)] = min(i, j)
