"""The local matcher's compiled inner loops: costs of pixels, and the winning disparity.

The costs are census and zero-mean normalised correlation. All functions release the GIL and work on
separate rows, so that threads can share an image. Costs are integers: their sums do not depend on
the order, so that the torch backend gives the same disparities.
"""

import numpy as np

from sensors.stereo.local_options import DISPARITIES, ZNCC_STEPS
from std_toolkit.compiled import compiled

QUADRATIC, EQUIANGULAR, GAUSSIAN, NONE = 0, 1, 2, 3

_NEVER = np.int32(2**31 - 1)

CENSUS_RADIUS = 3


@compiled
def winners(  # type: ignore[no-untyped-def]
    costs, sum_of, top, y0, y1, height, radius, d0, uniqueness, left_right, curve, plateau, out
):
    """Disparities of rows y0..y1.

    Sums of windows that extend beyond the border, or where the right pixel is outside, are scaled
    to the full number of pixels. The winner is the minimum of `cost * DISPARITIES + index`: for
    equal costs the smaller disparity.

    Args:
        costs: (rows, W, D) uint8 or uint16 of rows top, top + 1, ...
        sum_of: empty array whose type holds the sum of a window: the smaller, the faster.
        radius: of the aggregation.
        uniqueness: percent.
        left_right: pixels, -1 = not checked.
        curve: of the sub-pixel fit.
        plateau: cost at the foot of the gaussian.
        out: (H, W) float32, 0 = none.
    """
    width, count = costs.shape[1], costs.shape[2]
    side = 2 * radius + 1
    full = np.int32(side * side)
    columns = np.zeros((width, count), dtype=sum_of.dtype)
    sums = np.zeros((width, count), dtype=sum_of.dtype)
    window = np.empty(count, dtype=sum_of.dtype)
    right_key = np.empty(width, dtype=np.int32)
    left_key = np.empty(width, dtype=np.int32)
    for y in range(max(0, y0 - radius), min(height, y0 + radius)):
        _add(columns, costs[y - top], 1)
    for y in range(y0, y1):
        if y + radius < height:
            _add(columns, costs[y + radius - top], 1)
        if y - radius - 1 >= 0 and y > y0:
            _add(columns, costs[y - radius - 1 - top], -1)
        rows = np.int32(min(height, y + radius + 1) - max(0, y - radius))
        window[:] = 0
        right_key[:] = _NEVER
        for x in range(min(radius, width)):
            for d in range(count):
                window[d] += columns[x, d]
        for x in range(width):
            if x + radius < width and x - radius - 1 >= 0:
                for d in range(count):
                    window[d] += columns[x + radius, d] - columns[x - radius - 1, d]
            elif x + radius < width:
                for d in range(count):
                    window[d] += columns[x + radius, d]
            elif x - radius - 1 >= 0:
                for d in range(count):
                    window[d] -= columns[x - radius - 1, d]
            reach = max(0, min(count, x - d0 + 1))
            here = sums[x]
            last = min(x + radius, width - 1)
            # Right pixels of small disparities are inside for the whole window.
            inside = min(reach, max(0, x - radius - d0 + 1))
            if rows == side and last == x + radius:
                for d in range(inside):
                    here[d] = window[d]
            else:
                pixels = rows * np.int32(last + 1 - max(x - radius, d0))
                for d in range(inside):
                    here[d] = (np.int32(window[d]) * full + pixels // 2) // pixels
            for d in range(inside, reach):
                pixels = rows * np.int32(last + 1 - max(x - radius, d0 + d))
                here[d] = (np.int32(window[d]) * full + pixels // 2) // pixels
            best = _NEVER
            for d in range(reach):
                best = min(best, np.int32(here[d]) * np.int32(DISPARITIES) + np.int32(d))
            left_key[x] = best
            # The right image's keys are mirrored, so that both run upwards with the disparity.
            # As a part of the array: from 0 on, the compiler uses vectors.
            first = width - 1 - x + d0
            keys = right_key[first : first + reach]
            for d in range(reach):
                key = np.int32(here[d]) * np.int32(DISPARITIES) + np.int32(d)
                keys[d] = min(keys[d], key)
        for x in range(width):
            reach = max(0, min(count, x - d0 + 1))
            out[y, x] = _checked(
                sums[x],
                reach,
                left_key[x],
                right_key,
                x,
                d0,
                uniqueness,
                left_right,
                curve,
                plateau,
            )


@compiled
def _add(columns, costs, sign):  # type: ignore[no-untyped-def]
    if sign > 0:
        for x in range(columns.shape[0]):
            for d in range(columns.shape[1]):
                columns[x, d] += costs[x, d]
    else:
        for x in range(columns.shape[0]):
            for d in range(columns.shape[1]):
                columns[x, d] -= costs[x, d]


@compiled
def _checked(  # type: ignore[no-untyped-def]
    costs, reach, key, right_key, x, d0, uniqueness, left_right, curve, plateau
):
    """Disparity of one pixel from its costs, 0 if it fails a check."""
    best = key % DISPARITIES
    if key == _NEVER or best == 0 or best + 1 >= reach:
        return np.float32(0)
    least = np.int32(costs[best])
    second = _NEVER
    above = costs[best + 2 : reach]
    for d in range(best - 1):
        second = min(second, np.int32(costs[d]))
    for d in range(above.size):
        second = min(second, np.int32(above[d]))
    if second != _NEVER and np.int64(least) * 100 >= np.int64(second) * (100 - uniqueness):
        return np.float32(0)
    if left_right >= 0:
        mirrored = right_key.size - 1 - x + d0 + best
        if abs(right_key[mirrored] % DISPARITIES - best) > left_right:
            return np.float32(0)
    before, after = np.int32(costs[best - 1]), np.int32(costs[best + 1])
    offset = _offset(before, least, after, curve, plateau)
    return np.float32(d0 + best) + offset


@compiled
def _offset(before, least, after, curve, plateau):  # type: ignore[no-untyped-def]
    """Position of the curve's minimum, -0.5 to 0.5 of a pixel."""
    if curve == NONE:
        return np.float32(0)
    if curve == GAUSSIAN:
        # Costs above the foot have no logarithm; the winner next to them is an isolated peak.
        floor = np.float64(plateau) * 1e-3
        a = np.log(max(np.float64(plateau - before), floor))
        b = np.log(max(np.float64(plateau - after), floor))
        c = np.log(max(np.float64(plateau - least), floor))
        bend = a + b - 2 * c
        if bend > -1e-12:
            return np.float32(0)
        return np.float32(min(0.5, max(-0.5, (a - b) / (2 * bend))))
    if curve == QUADRATIC:
        bend = 2 * (before + after - 2 * least)
    else:
        bend = 2 * (max(before, after) - least)
    if bend == 0:
        return np.float32(0)
    return np.float32(before - after) / np.float32(bend)


@compiled
def census(image, y0, y1, out):  # type: ignore[no-untyped-def]
    """Rows y0..y1 of the census: one bit per neighbour in 7x7 that is darker than the centre.

    Args:
        image: (H + 6, W + 6) uint8, the image padded by its border pixels.
        out: (H, W) uint64.
    """
    width = out.shape[1]
    for y in range(y0, y1):
        for x in range(width):
            out[y, x] = 0
        for dy in range(7):
            for dx in range(7):
                if dy == CENSUS_RADIUS and dx == CENSUS_RADIUS:
                    continue
                for x in range(width):
                    darker = image[y + dy, x + dx] < image[y + CENSUS_RADIUS, x + CENSUS_RADIUS]
                    out[y, x] = (out[y, x] << np.uint64(1)) | np.uint64(darker)


@compiled
def _ones(word):  # type: ignore[no-untyped-def]
    """Number of set bits; LLVM compiles this to one instruction if the CPU has it."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.uint8((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@compiled
def census_rows(left, right, d0, y0, y1, out):  # type: ignore[no-untyped-def]
    """Differing bits: out[y - y0, x, d] for pixel x of row y and disparity d0 + d.

    Args:
        left, right: (H, W) uint64 of `census`.
        out: (>= y1 - y0, W, D) uint8; 0 where the right pixel is outside.
    """
    width, count = left.shape[1], out.shape[2]
    mirrored = np.empty(width, dtype=np.uint64)
    for y in range(y0, y1):
        for x in range(width):
            mirrored[width - 1 - x] = right[y, x]
        for x in range(width):
            row = out[y - y0, x]
            here = left[y, x]
            reach = min(count, x - d0 + 1)
            first = width - 1 - x + d0
            for d in range(reach):
                row[d] = _ones(here ^ mirrored[first + d])
            for d in range(max(reach, 0), count):
                row[d] = 0


@compiled
def zncc_rows(left, right, l_sum, r_sum, l_inv, r_inv, size, d0, y0, y1, out):  # type: ignore[no-untyped-def]
    """Steps of 1 - correlation, 0 to 2 ZNCC_STEPS, in the layout of `census_rows`.

    Args:
        left, right: (H + size - 1, W + size - 1) uint8, padded by their border pixels.
        l_sum, r_sum: (H, W) int32 sums over the windows.
        l_inv, r_inv: (H, W) float64, one over (number of pixels times standard deviation).
        size: side of the window.
        out: (>= y1 - y0, W, D) uint16; 0 where the right pixel is outside.
    """
    width = l_sum.shape[1]
    count, padded = out.shape[2], left.shape[1]
    pixels = np.int32(size * size)
    columns = np.zeros((padded, count), dtype=np.int32)
    window = np.empty(count, dtype=np.int32)
    for y in range(y0, y1):
        first_row = y0 if y == y0 else y + size - 1
        for row in range(first_row, y + size):
            for x in range(padded):
                a = np.int32(left[row, x])
                for d in range(min(count, x - d0 + 1)):
                    columns[x, d] += a * np.int32(right[row, x - d0 - d])
        if y > y0:
            for x in range(padded):
                a = np.int32(left[y - 1, x])
                for d in range(min(count, x - d0 + 1)):
                    columns[x, d] -= a * np.int32(right[y - 1, x - d0 - d])
        window[:] = 0
        for x in range(size - 1):
            for d in range(count):
                window[d] += columns[x, d]
        for x in range(width):
            for d in range(count):
                window[d] += columns[x + size - 1, d]
            reach = min(count, x - d0 + 1)
            for d in range(reach):
                right_x = x - d0 - d
                top = pixels * window[d] - l_sum[y, x] * r_sum[y, right_x]
                correlation = np.float64(top) * l_inv[y, x] * r_inv[y, right_x]
                out[y - y0, x, d] = np.uint16((1.0 - correlation) * ZNCC_STEPS + 0.5)
            for d in range(max(reach, 0), count):
                out[y - y0, x, d] = 0
            for d in range(count):
                window[d] -= columns[x, d]
