"""Aggregation, winner, its checks and the sub-pixel fit, compiled, for one band of rows."""

from __future__ import annotations

import numpy as np

from sensors.compiled import compiled
from sensors.stereo.options import DISPARITIES

QUADRATIC, EQUIANGULAR, GAUSSIAN, NONE = 0, 1, 2, 3
_NEVER = np.int32(2**31 - 1)


@compiled
def winners(  # type: ignore[no-untyped-def]
    costs, top, y0, y1, height, radius, d0, uniqueness, left_right, curve, plateau, out
):
    """Disparities of rows y0..y1.

    Sums of windows that reach over the border, or where the right pixel lies outside, are scaled to
    the full number of pixels. The winner is the least `cost * DISPARITIES + index`: of equal costs
    the smaller disparity.

    Args:
        costs: (rows, W, D) uint16 of rows top, top + 1, ...
        radius: of the aggregation.
        uniqueness: percent.
        left_right: pixels, -1 = not checked.
        curve: of the sub-pixel fit.
        plateau: cost at which the gaussian has its foot.
        out: (H, W) float32, 0 = none.
    """
    width, count = costs.shape[1], costs.shape[2]
    side = 2 * radius + 1
    full = np.int32(side * side)
    columns = np.zeros((width, count), dtype=np.int32)
    sums = np.zeros((width, count), dtype=np.int32)
    window = np.empty(count, dtype=np.int32)
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
            if x + radius < width:
                for d in range(count):
                    window[d] += columns[x + radius, d]
            if x - radius - 1 >= 0:
                for d in range(count):
                    window[d] -= columns[x - radius - 1, d]
            reach = max(0, min(count, x - d0 + 1))
            here = sums[x]
            last = min(x + radius, width - 1)
            if rows == side and last == x + radius and x - radius >= d0 + count - 1:
                for d in range(reach):
                    here[d] = window[d]
            else:
                for d in range(reach):
                    pixels = rows * np.int32(last + 1 - max(x - radius, d0 + d))
                    here[d] = (window[d] * full + pixels // 2) // pixels
            best = _NEVER
            for d in range(reach):
                best = min(best, here[d] * np.int32(DISPARITIES) + np.int32(d))
            left_key[x] = best
            # The right image's keys lie mirrored, so that both run upwards with the disparity.
            first = width - 1 - x + d0
            for d in range(reach):
                key = here[d] * np.int32(DISPARITIES) + np.int32(d)
                right_key[first + d] = min(right_key[first + d], key)
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
    for x in range(columns.shape[0]):
        for d in range(columns.shape[1]):
            columns[x, d] += np.int32(sign) * np.int32(costs[x, d])


@compiled
def _checked(  # type: ignore[no-untyped-def]
    costs, reach, key, right_key, x, d0, uniqueness, left_right, curve, plateau
):
    """Disparity of one pixel from its costs, 0 where it fails a check."""
    best = key % DISPARITIES
    if key == _NEVER or best == 0 or best + 1 >= reach:
        return np.float32(0)
    least = costs[best]
    second = _NEVER
    for d in range(best - 1):
        second = min(second, costs[d])
    for d in range(best + 2, reach):
        second = min(second, costs[d])
    if second != _NEVER and np.int64(least) * 100 >= np.int64(second) * (100 - uniqueness):
        return np.float32(0)
    if left_right >= 0:
        mirrored = right_key.size - 1 - x + d0 + best
        if abs(right_key[mirrored] % DISPARITIES - best) > left_right:
            return np.float32(0)
    offset = _offset(costs[best - 1], least, costs[best + 1], curve, plateau)
    return np.float32(d0 + best) + offset


@compiled
def _offset(before, least, after, curve, plateau):  # type: ignore[no-untyped-def]
    """Place of the curve's minimum, -0.5 to 0.5 of a pixel."""
    if curve == NONE:
        return np.float32(0)
    if curve == GAUSSIAN:
        # Costs above the foot have no logarithm; the winner next to them is a lone peak.
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
