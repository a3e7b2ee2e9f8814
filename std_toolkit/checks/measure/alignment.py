"""Shift of the sensor depth against the colour image, from the outlines of labelled objects.

Along the normal of every contour point, the sensor's depth agrees with the label up to the place
where the object ends in the depth image. That place is `margin + normal . shift`: sensors lose or
add some pixels all around an outline (the margin), while a misalignment moves the whole outline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.contours import Contour

Array = NDArray[np.float64]

REACH_PX = 14.0
_STEP_PX = 0.5
# Depth that differs more from the label belongs to another surface.
_TOLERANCE_M = 0.02
# Fraction of a profile that agrees with one boundary.
_CLEAR = 0.85
FEWEST_POINTS = 30
_LARGEST_SAMPLE = 300
# Fits with a larger spread of the boundaries do not determine a shift.
_LARGEST_SPREAD_PX = 2.5


@dataclass(frozen=True, slots=True)
class DepthShift:
    """Shift of the depth image against a contour that fits the colour image.

    Attributes:
        x_px, y_px: positive if depth is to the right and below.
        std_px: standard deviation of the shift, from the spread of the boundaries.
        points: number of contour points used.
    """

    x_px: float
    y_px: float
    std_px: float
    points: int


def depth_shift(
    contour: Contour, rendered: NDArray[np.floating], sensor: NDArray[np.floating]
) -> DepthShift | None:
    """The shift of the depth image at one object.

    Args:
        contour: visible outline of the object.
        rendered: (H, W) z-depth of the labels in metres, 0 = background.
        sensor: (H, W) z-depth of the sensor in metres, 0 = none.

    Returns:
        None if the outline in depth is unclear, or its directions do not determine both axes.
    """
    index = np.flatnonzero(contour.own)
    if len(index) < FEWEST_POINTS:
        return None
    if len(index) > _LARGEST_SAMPLE:
        index = index[np.linspace(0, len(index) - 1, _LARGEST_SAMPLE).round().astype(int)]
    normals = contour.normals[index]
    offsets = np.arange(-REACH_PX, REACH_PX + _STEP_PX / 2, _STEP_PX)
    at = contour.points[index][:, None] + offsets[:, None] * normals[:, None]
    measured, label = (_sampled(image, at) for image in (sensor, rendered))
    expected = np.where((offsets < 0) & (label > 0), label, contour.depth[index][:, None])
    near = np.abs(measured - expected) < _TOLERANCE_M
    boundary, agreement = _boundaries(near, offsets)
    # A profile without a reading does not show where the object ends.
    inner = near[:, offsets <= -REACH_PX / 2].mean(axis=1) > 0.5
    use = inner & (agreement >= _CLEAR) & (np.abs(boundary) < REACH_PX - 1)
    if use.sum() < FEWEST_POINTS or use.mean() < 0.3:
        return None
    return _fit(boundary[use], normals[use])


def common_depth_shift(shifts: Sequence[DepthShift]) -> DepthShift | None:
    """The shift that several objects or frames share: the median, with its deviation."""
    if not shifts:
        return None
    xy = np.array([[s.x_px, s.y_px] for s in shifts])
    middle = np.median(xy, axis=0)
    spread = 1.4826 * float(np.median(np.linalg.norm(xy - middle, axis=1)))
    std = max(spread, float(np.median([s.std_px for s in shifts]))) / np.sqrt(len(shifts))
    return DepthShift(float(middle[0]), float(middle[1]), float(std), sum(s.points for s in shifts))


def _sampled(image: NDArray[np.floating], at: Array) -> Array:
    u, v = (at[..., k].astype(np.float32) for k in (0, 1))
    # Nearest: interpolated depth at an outline belongs to no surface.
    return cv2.remap(image.astype(np.float32, copy=False), u, v, cv2.INTER_NEAREST).astype(
        np.float64
    )


def _boundaries(near: NDArray[np.bool_], offsets: Array) -> tuple[Array, Array]:
    """(P,) end of the object on each profile, and the fraction of the profile that agrees."""
    inside = np.cumsum(near, axis=1)
    outside = np.cumsum(~near[:, ::-1], axis=1)[:, ::-1]
    # The object ends after sample k: samples up to k agree with it, the later ones do not.
    later = np.concatenate([outside[:, 1:], np.zeros((len(near), 1))], axis=1)
    score = inside + later
    best = score.argmax(axis=1)
    return offsets[best] + _STEP_PX / 2, score[np.arange(len(near)), best] / len(offsets)


def _fit(boundary: Array, normals: Array) -> DepthShift | None:
    """Robust fit of margin and shift; None if it is ill-conditioned or spread too widely."""
    A = np.concatenate([np.ones((len(normals), 1)), normals], axis=1)
    weights = np.ones(len(A))
    solution = np.zeros(3)
    scale = _LARGEST_SPREAD_PX
    for _ in range(15):
        M = (A * weights[:, None]).T @ A
        if np.linalg.eigvalsh(M / weights.sum())[0] < 0.05:
            return None
        solution = np.linalg.solve(M, (A * weights[:, None]).T @ boundary)
        residual = np.abs(boundary - A @ solution)
        scale = max(1.4826 * float(np.median(residual)), _STEP_PX)
        weights = 1 / (1 + (residual / scale) ** 2)
    if scale > _LARGEST_SPREAD_PX:
        return None
    # Neighbouring boundaries are correlated over some pixels: count a quarter of them.
    variance = scale**2 * np.linalg.inv((A * weights[:, None]).T @ A / 4)
    return DepthShift(
        float(solution[1]),
        float(solution[2]),
        float(np.sqrt(np.linalg.eigvalsh(variance[1:, 1:])[-1])),
        len(A),
    )
