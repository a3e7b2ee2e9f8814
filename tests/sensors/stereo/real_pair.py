"""A real D415's infrared pair and how a disparity map compares with the camera's own depth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.stereo import disparity_to_depth
from std_toolkit.io.images import read_depth, read_png

# Of its own intrinsics.txt, for infrared at 640x360.
FOCAL_PX = 443.914642333984
BASELINE_M = 0.0547803528606892


@dataclass(frozen=True)
class Pair:
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    depth: NDArray[np.float32]


@dataclass(frozen=True)
class Agreement:
    """With the camera's depth where both are valid, after one factor on all depths.

    Attributes:
        scale: the factor.
        median_mm: median absolute difference.
        within_10_mm: share that differs by at most 10 mm.
        complete, camera_complete: shares of valid pixels in the whole picture.
        shared: share of the camera's valid pixels that are valid here.
    """

    scale: float
    median_mm: float
    within_10_mm: float
    complete: float
    camera_complete: float
    shared: float


def load_pair(test_data: Path) -> Pair:
    folder = test_data / "d415_stereo_pair"
    left, right = (read_png(folder / f"0000_ir_{side}.png") for side in "lr")
    depth = read_depth(folder / "0000_depth.png", scale=0.001)
    # Three equal channels.
    return Pair(left[..., 0].astype(np.uint8), right[..., 0].astype(np.uint8), depth)


def compare(pair: Pair, disparity: NDArray[np.float32]) -> Agreement:
    depth = disparity_to_depth(disparity, focal_px=FOCAL_PX, baseline_m=BASELINE_M)
    both = (depth > 0) & (pair.depth > 0)
    ratio = pair.depth[both].astype(float) / depth[both]
    scale = float(np.median(ratio))
    for _ in range(20):  # the median of those that are near, until it stays
        near = abs(depth[both] * scale - pair.depth[both]) < 0.01
        scale = float(np.median(ratio[near]))
    error = abs(depth[both] * scale - pair.depth[both]) * 1000
    return Agreement(
        scale=scale,
        median_mm=float(np.median(error)),
        within_10_mm=float((error <= 10).mean()),
        complete=float((depth > 0).mean()),
        camera_complete=float((pair.depth > 0).mean()),
        shared=float(both.sum() / (pair.depth > 0).sum()),
    )
