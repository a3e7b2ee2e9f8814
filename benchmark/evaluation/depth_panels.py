"""Depth and its error as pictures, side by side."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame, resize_nearest

Image = NDArray[np.uint8]
# Titles of the panels of a strip, from the left.
PANELS = ("colour", "raw depth", "restored", "ground truth", "error")
TRUST_PANEL = "trust in the sensor"  # last panel, for methods that output a confidence
PANEL_WIDTH = 320
# Larger errors have the last colour: depth with an error of 5 cm is useless for a gripper.
LARGEST_ERROR_M = 0.05
_NOTHING = np.array((28, 28, 32), np.uint8)  # no depth, or no ground truth
_MISSED = np.array((150, 60, 200), np.uint8)  # ground truth without a prediction
_GAP = 4


@dataclass(frozen=True)
class DepthScale:
    """Depth range of the colour map, metres."""

    near: float
    far: float


def depth_scale(frame: DepthFrame) -> DepthScale:
    """Return one scale for all depth panels of a frame: the range of its ground truth."""
    return range_of(frame.depth_true if (frame.depth_true > 0).any() else frame.depth_raw)


def range_of(depth: NDArray[np.float32]) -> DepthScale:
    """Return the range of all but the nearest and the farthest percent of the measured depth."""
    there = depth[depth > 0]
    if not there.size:
        return DepthScale(0.0, 1.0)
    near, far = np.percentile(there, (1, 99))
    margin = 0.05 * (far - near) + 0.01
    return DepthScale(float(near - margin), float(far + margin))


def strip(
    frame: DepthFrame,
    restored: NDArray[np.float32],
    confidence: NDArray[np.float32] | None = None,
) -> Image:
    """Return the panels of `PANELS` side by side, (h, w, 3), plus `TRUST_PANEL` if given."""
    scale = depth_scale(frame)
    width = PANEL_WIDTH
    height = round(width * frame.camera.height / frame.camera.width)
    size = (width, height)
    color = cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA)
    true = frame.depth_true
    native = (true.shape[1], true.shape[0])
    answer = resize_nearest(np.asarray(restored, np.float32), native)
    panels = [
        np.asarray(color, np.uint8),
        depth_picture(resize_nearest(frame.depth_raw, size), scale),
        depth_picture(resize_nearest(answer, size), scale),
        depth_picture(resize_nearest(true, size), scale),
        resize_nearest(error_picture(answer, true), size),
    ]
    if confidence is not None:
        panels.append(trust_picture(resize_nearest(np.asarray(confidence, np.float32), size)))
    return _side_by_side(panels)


def restored_strip(
    color: NDArray[np.uint8],
    raw: NDArray[np.float32],
    restored: NDArray[np.float32],
    confidence: NDArray[np.float32] | None = None,
    *,
    width: int = 480,
    scale: DepthScale | None = None,
) -> Image:
    """Return colour, raw and restored depth of one size side by side, plus `TRUST_PANEL` if given.

    The colours of depth span `scale`, or the restored depth; at most `width` pixels per panel.
    """
    width = min(width, color.shape[1])
    size = (width, round(width * color.shape[0] / color.shape[1]))
    scale = scale or range_of(restored if (restored > 0).any() else raw)
    panels = [np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)]
    panels += [depth_picture(resize_nearest(depth, size), scale) for depth in (raw, restored)]
    if confidence is not None:
        panels.append(trust_picture(resize_nearest(confidence, size)))
    return _side_by_side(panels)


def _side_by_side(panels: Sequence[Image]) -> Image:
    gap = np.full((panels[0].shape[0], _GAP, 3), 255, np.uint8)
    return np.hstack([part for panel in panels for part in (panel, gap)][:-1])


def depth_picture(depth: NDArray[np.float32], scale: DepthScale) -> Image:
    """Return depth in colours, (h, w, 3): near is bright, missing depth almost black."""
    there = np.isfinite(depth) & (depth > 0)
    level = np.clip((np.where(there, depth, 0) - scale.near) / (scale.far - scale.near), 0, 1)
    picture = _colored(1 - level, cv2.COLORMAP_VIRIDIS)
    picture[~there] = _NOTHING
    return picture


def error_picture(restored: NDArray[np.float32], true: NDArray[np.float32]) -> Image:
    """Return the absolute error in colours, (h, w, 3), up to `LARGEST_ERROR_M`.

    Pixels without a prediction are violet, pixels without ground truth almost black.
    """
    known = np.isfinite(true) & (true > 0)
    answered = np.isfinite(restored) & (restored > 0)
    error = np.abs(np.where(known & answered, restored - true, 0))
    picture = _colored(np.clip(error / LARGEST_ERROR_M, 0, 1), cv2.COLORMAP_INFERNO)
    picture[~known] = _NOTHING
    picture[known & ~answered] = _MISSED
    return picture


def trust_picture(confidence: NDArray[np.float32]) -> Image:
    """Return the confidence in the sensor depth in grey, (h, w, 3): 0 is black, 1 is light."""
    return _colored(np.clip(confidence, 0, 1), cv2.COLORMAP_BONE)


def _colored(level: NDArray[np.floating], scale: int) -> Image:
    grey = np.rint(255 * level).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(grey, scale)[..., ::-1])
