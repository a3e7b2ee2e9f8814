"""Nearest of many rectangles at every pixel, compiled."""

from __future__ import annotations

import numpy as np

from sensors.compiled import compiled

# Cameras that are turned against each other see rows of patches as slightly slanted: patches
# overlap by as much, in pixels, for no centre to fall between.
OVERLAP_PX = 0.02


@compiled
def splat(spans, depth, out):  # type: ignore[no-untyped-def]
    """Put rectangles into a depth image; of several at a pixel the nearest stays.

    Args:
        spans: (N, 4) float64 pixels: left, right, upper, lower edge. A rectangle covers the pixels
            whose centres, at whole numbers, lie inside.
        depth: (N,) float32.
        out: (H, W) float32, changed in place; infinite where nothing is.
    """
    height, width = out.shape
    for i in range(len(spans)):
        x0 = max(0, int(np.ceil(max(spans[i, 0] - OVERLAP_PX, -1.0))))
        x1 = min(width - 1, int(np.floor(min(spans[i, 1] + OVERLAP_PX, float(width)))))
        y0 = max(0, int(np.ceil(max(spans[i, 2] - OVERLAP_PX, -1.0))))
        y1 = min(height - 1, int(np.floor(min(spans[i, 3] + OVERLAP_PX, float(height)))))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                out[y, x] = min(out[y, x], depth[i])
