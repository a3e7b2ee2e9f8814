"""The local matcher on the processor: bands of rows over threads of compiled code."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sensors.stereo import numba_cost, numba_winner
from sensors.stereo.matcher import Disparity, Image
from sensors.stereo.numba_filters import median_rows, remove_speckles
from sensors.stereo.options import Cost, LocalMatcherOptions, Subpixel
from sensors.stereo.zncc_windows import window_sums

# Rows of a band: few enough that its costs (10 MB for 100 disparities of 640 columns) and those of
# the rows that it shares with its neighbours are cheap, many enough that the latter are few.
BAND_ROWS = 45
CURVES = {
    Subpixel.QUADRATIC: numba_winner.QUADRATIC,
    Subpixel.EQUIANGULAR: numba_winner.EQUIANGULAR,
    Subpixel.GAUSSIAN: numba_winner.GAUSSIAN,
    Subpixel.NONE: numba_winner.NONE,
}
Rows = Callable[[int, int, NDArray[np.uint16]], None]


def match(left: Image, right: Image, options: LocalMatcherOptions, threads: int) -> Disparity:
    """See `LocalMatcher.match`. Threads are Python's own: numba's may not outlive a fork."""
    height, width = left.shape
    bands = list(pairwise([*range(0, height, BAND_ROWS), height]))
    with ThreadPoolExecutor(threads) as pool:
        cost_rows = _cost_rows(left, right, options, pool, bands)
        found = np.zeros((height, width), dtype=np.float32)
        radius = options.aggregation_px // 2

        def band_winners(band: tuple[int, int]) -> None:
            y0, y1 = band
            top, bottom = max(0, y0 - radius), min(height, y1 + radius)
            costs = np.empty((bottom - top, width, options.count), dtype=np.uint16)
            cost_rows(top, bottom, costs)
            numba_winner.winners(
                costs, top, y0, y1, height, radius, options.min_disparity,
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
    """The picture continued by its border pixels."""
    return np.pad(image, radius, mode="edge")


def _cost_rows(
    left: Image,
    right: Image,
    options: LocalMatcherOptions,
    pool: ThreadPoolExecutor,
    bands: list[tuple[int, int]],
) -> Rows:
    """What fills in the costs of some rows."""
    d0 = options.min_disparity
    if options.cost is Cost.CENSUS:
        a, b = (_census(image, pool, bands) for image in (left, right))
        return lambda y0, y1, out: numba_cost.census_rows(a, b, d0, y0, y1, out)
    size = options.zncc_px
    a, b = (continued(image, size // 2) for image in (left, right))
    (l_sum, l_inv), (r_sum, r_inv) = window_sums(a, size), window_sums(b, size)
    return lambda y0, y1, out: numba_cost.zncc_rows(
        a, b, l_sum, r_sum, l_inv, r_inv, size, d0, y0, y1, out
    )


def _census(
    image: Image, pool: ThreadPoolExecutor, bands: list[tuple[int, int]]
) -> NDArray[np.generic]:
    padded = continued(image, numba_cost.CENSUS_RADIUS)
    out = np.empty(image.shape, dtype=np.uint64)
    list(pool.map(lambda band: numba_cost.census(padded, band[0], band[1], out), bands))
    return out
