"""Filters of a disparity map with holes, compiled."""

from __future__ import annotations

import numpy as np

from sensors.compiled import compiled


@compiled
def median_rows(disparity, side, y0, y1, out):  # type: ignore[no-untyped-def]
    """Rows y0..y1: of every valid pixel the (lower) median of the valid ones around it.

    Holes stay holes: their disparity is 0 and takes no part.
    """
    height, width = disparity.shape
    radius = side // 2
    values = np.empty(side * side, dtype=np.float32)
    for y in range(y0, y1):
        for x in range(width):
            if disparity[y, x] == 0:
                out[y, x] = 0
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
