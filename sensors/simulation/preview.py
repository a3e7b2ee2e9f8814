"""A contact sheet: colour, infrared, raw depth, exact depth and error of a few frames."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.output import SimulatedFrame

Image = NDArray[np.uint8]
# Error at which the colour scale ends.
LARGEST_ERROR_M = 0.02
NO_DEPTH = (24, 24, 28)
_NO_ERROR = (52, 34, 64)
_TITLES = ("colour", "left infrared", "raw depth", "exact depth", "error, 0 to 20 mm")
_TILE_WIDTH, _MARGIN, _HEADING = 400, 6, 26


def contact_sheet(frames: list[SimulatedFrame]) -> Image:
    """(H, W, 3) uint8 RGB, a row for each frame.

    Depth runs from blue (near) to red within the frame's own range; where nothing was measured it
    is dark, in the error picture violet.
    """
    rows = [_row(frame) for frame in frames]
    width = rows[0].shape[1]
    heading = np.full((_HEADING, width, 3), 255, np.uint8)
    for i, title in enumerate(_TITLES):
        at = (i * (_TILE_WIDTH + _MARGIN) + 4, 18)
        cv2.putText(heading, title, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA)
    gap = np.full((_MARGIN, width, 3), 255, np.uint8)
    parts = [heading]
    for row in rows:
        parts += [row, gap]
    return np.concatenate(parts[:-1])


def _row(frame: SimulatedFrame) -> Image:
    exact = frame.depth_exact
    low, high = np.percentile(exact[exact > 0], [1, 99]) if (exact > 0).any() else (0.0, 1.0)
    error = np.abs(frame.depth_aligned - exact) / LARGEST_ERROR_M
    error_picture = _colored(error, cv2.COLORMAP_VIRIDIS)
    error_picture[frame.depth_aligned <= 0] = _NO_ERROR
    tiles = (
        frame.color,
        np.repeat(frame.infrared_left[..., None], 3, axis=2),
        _depth(frame.depth_aligned, low, high),
        _depth(exact, low, high),
        error_picture,
    )
    height = round(_TILE_WIDTH * exact.shape[0] / exact.shape[1])
    gap = np.full((height, _MARGIN, 3), 255, np.uint8)
    parts: list[Image] = []
    for tile in tiles:
        small = cv2.resize(tile, (_TILE_WIDTH, height), interpolation=cv2.INTER_AREA)
        parts += [np.asarray(small, np.uint8), gap]
    return np.concatenate(parts[:-1], axis=1)


def _depth(depth: NDArray[np.float32], low: float, high: float) -> Image:
    picture = _colored((depth - low) / max(high - low, 1e-6), cv2.COLORMAP_TURBO)
    picture[depth <= 0] = NO_DEPTH
    return picture


def _colored(values: NDArray[np.floating], scale: int) -> Image:
    grey = (255 * np.clip(values, 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(grey, scale)[..., ::-1])
