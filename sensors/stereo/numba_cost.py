"""Costs of single pixels, compiled: census and zero-mean normalised correlation.

All functions release the interpreter's lock and work on rows of their own, so that threads share a
picture. Costs are integers: sums of them do not depend on their order, which makes the torch
backend give the same disparities.
"""

from __future__ import annotations

import numpy as np

from sensors.compiled import compiled
from sensors.stereo.options import ZNCC_STEPS

CENSUS_RADIUS = 3


@compiled
def census(image, y0, y1, out):  # type: ignore[no-untyped-def]
    """Rows y0..y1 of the census: one bit per neighbour in 7x7 that is darker than the centre.

    Args:
        image: (H + 6, W + 6) uint8, the picture continued by its border pixels.
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
    """Number of set bits; LLVM makes one instruction of this where the processor has it."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.uint16((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@compiled
def census_rows(left, right, d0, y0, y1, out):  # type: ignore[no-untyped-def]
    """Bits that differ: out[y - y0, x, d] for pixel x of row y and disparity d0 + d, both images'.

    Args:
        left, right: (H, W) uint64 of `census`.
        out: (>= y1 - y0, W, D) uint16; 0 where the right pixel lies outside.
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
        left, right: (H + size - 1, W + size - 1) uint8, continued by their border pixels.
        l_sum, r_sum: (H, W) int32 sums over the windows.
        l_inv, r_inv: (H, W) float64, one over (number of pixels times standard deviation).
        size: side of the window.
        out: (>= y1 - y0, W, D) uint16; 0 where the right pixel lies outside.
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
