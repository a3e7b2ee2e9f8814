"""Sensor depth: residuals of the labels, errors of the sensor, shift against the colour image.

The shift is measured at the outlines of labelled objects. Along the normal of every contour point,
the sensor's depth agrees with the label up to the place where the object ends in the depth image.
That place is `margin + normal . shift`: sensors lose or add some pixels all around an outline (the
margin), while a misalignment moves the whole outline.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.array_file import ArrayFile, FiledArray
from std_toolkit.checks.measure.contours import Contour
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Depth sensors mix foreground and background within some pixels of an outline.
EDGE_MARGIN_PX = 3
HISTOGRAM_LIMIT_M = 0.5
HISTOGRAM_BIN_M = 0.0005
_SHOWN_BIN_M = 0.002
_SHOWN_LIMIT_M = 0.1
_BINS = round(2 * HISTOGRAM_LIMIT_M / HISTOGRAM_BIN_M)
_REACH_PX = 14.0
_STEP_PX = 0.5
_LARGEST_SAMPLE = 300


@dataclass(frozen=True, kw_only=True)
class SensorDepthSettings(Settings):
    """Residuals and shifts of sensor depth that count."""

    fewest_pixels: int = limit(50, source=NOT_RECORDED)
    """pixels with sensor depth that a residual needs"""
    tolerance_m: float = limit(0.02, unit="m", source=NOT_RECORDED)
    """depth that differs more from the label belongs to another surface"""
    clear: float = limit(0.85, source=NOT_RECORDED)
    """fraction of a profile that agrees with one boundary"""
    fewest_points: int = limit(30, source=NOT_RECORDED)
    """points of an outline that a shift needs"""
    largest_spread_px: float = limit(2.5, unit="px", source=NOT_RECORDED)
    """fits with a larger spread of the boundaries do not determine a shift"""


@dataclass(frozen=True, slots=True)
class DepthResidual:
    """Rendered minus sensor depth on one object in one frame.

    Attributes:
        median_m: positive if the label is behind the measured surface.
        mad_m: median absolute deviation from the median.
        relative: median of rendered over sensor depth, minus 1; nonzero for a wrong scale.
        depth_m: median rendered depth.
        pixels: number of pixels used.
    """

    median_m: float
    mad_m: float
    relative: float
    depth_m: float
    pixels: int


def inner_part(mask: NDArray[np.bool_]) -> tuple[tuple[slice, slice], NDArray[np.bool_]]:
    """Rows and columns of the image that hold a mask (H, W), and its pixels there that lie
    `EDGE_MARGIN_PX` inside of its outline."""
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    part = np.s_[y : y + h, x : x + w]
    size = 2 * EDGE_MARGIN_PX + 1
    inner = cv2.erode(
        mask[part].astype(np.uint8),
        cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    return part, inner.astype(bool)


def depth_residual(
    rendered: NDArray[np.floating], sensor: NDArray[np.floating], mask: NDArray[np.bool_]
) -> DepthResidual | None:
    """Robust statistics of rendered minus sensor depth, away from the outline.

    Args:
        rendered, sensor: (H, W) z-depth in metres, 0 = none.
        mask: (H, W) pixels that show the object.

    Returns:
        None if fewer than `SensorDepthSettings.current().fewest_pixels` pixels have both.
    """
    part, inner = inner_part(mask)
    rendered, sensor = rendered[part], sensor[part]
    use = inner & (rendered > 0) & (sensor > 0)
    count = int(use.sum())
    if count < SensorDepthSettings.current().fewest_pixels:
        return None
    r, s = rendered[use].astype(np.float64), sensor[use].astype(np.float64)
    median = float(np.median(r - s))
    return DepthResidual(
        median,
        float(np.median(np.abs(r - s - median))),
        float(np.median(r / s) - 1),
        float(np.median(r)),
        count,
    )


@dataclass(eq=False)
class ErrorTally:
    """Errors of raw depth over many pixels, as sums and a histogram of 0.5 mm bins.

    Attributes:
        truth_pixels: pixels with ground-truth depth.
        measured_pixels: of these, pixels with sensor depth.
        sum_abs, sum_square: of raw minus truth, metres.
        histogram: counts from -`HISTOGRAM_LIMIT_M`; the first and last bin include the rest.
    """

    truth_pixels: int = 0
    measured_pixels: int = 0
    sum_abs: float = 0.0
    sum_square: float = 0.0
    histogram: NDArray[np.int64] | None = None

    def add(self, raw: NDArray[np.floating], truth: NDArray[np.floating]) -> None:
        """Count pixels: raw and truth (N,) z-depth in metres, raw 0 = missing, truth > 0."""
        measured = raw > 0
        error = raw[measured].astype(np.float64) - truth[measured].astype(np.float64)
        self.truth_pixels += len(truth)
        self.measured_pixels += len(error)
        self.sum_abs += float(np.abs(error).sum())
        self.sum_square += float((error**2).sum())
        index = np.floor((error + HISTOGRAM_LIMIT_M) / HISTOGRAM_BIN_M).astype(np.int64)
        counts = np.bincount(np.clip(index, 0, _BINS - 1), minlength=_BINS)
        self.histogram = counts if self.histogram is None else self.histogram + counts

    def merge(self, other: ErrorTally) -> None:
        """Add the counts of another tally."""
        self.truth_pixels += other.truth_pixels
        self.measured_pixels += other.measured_pixels
        self.sum_abs += other.sum_abs
        self.sum_square += other.sum_square
        if other.histogram is not None:
            mine = 0 if self.histogram is None else self.histogram
            self.histogram = mine + other.histogram

    @classmethod
    def merged(cls, tallies: Iterable[ErrorTally | FiledTally]) -> ErrorTally:
        """The tally of all pixels of some tallies."""
        total = cls()
        for tally in tallies:
            total.merge(tally.load())
        return total

    @property
    def completeness(self) -> float | None:
        """Fraction of the ground-truth pixels with sensor depth."""
        return self.measured_pixels / self.truth_pixels if self.truth_pixels else None

    @property
    def mae_m(self) -> float | None:
        return self.sum_abs / self.measured_pixels if self.measured_pixels else None

    @property
    def rmse_m(self) -> float | None:
        return (
            float(np.sqrt(self.sum_square / self.measured_pixels)) if self.measured_pixels else None
        )

    def quantile_m(self, q: float) -> float | None:
        """Quantile of raw minus truth in metres, to half a bin (0.25 mm)."""
        if self.histogram is None or not self.measured_pixels:
            return None
        total = np.cumsum(self.histogram)
        index = int(np.searchsorted(total, q * total[-1], side="left"))
        before = total[index - 1] if index else 0
        part = (q * total[-1] - before) / max(int(self.histogram[index]), 1)
        return float(-HISTOGRAM_LIMIT_M + (index + np.clip(part, 0, 1)) * HISTOGRAM_BIN_M)

    def share_within(self, limit_m: float) -> float | None:
        """Fraction of the ground-truth pixels with a depth error below `limit_m`."""
        if self.histogram is None or not self.truth_pixels:
            return None
        reach = round(limit_m / HISTOGRAM_BIN_M)
        middle = _BINS // 2
        return float(self.histogram[middle - reach : middle + reach].sum() / self.truth_pixels)

    def shown_histogram(self) -> tuple[list[float], list[float]]:
        """Centres in mm of 2 mm bins over +-100 mm, and the share of the readings in each.

        The outermost bins include the rest.
        """
        if self.histogram is None or not self.measured_pixels:
            return [], []
        fine = -HISTOGRAM_LIMIT_M + (np.arange(len(self.histogram)) + 0.5) * HISTOGRAM_BIN_M
        count = round(2 * _SHOWN_LIMIT_M / _SHOWN_BIN_M)
        index = np.clip(((fine + _SHOWN_LIMIT_M) / _SHOWN_BIN_M).astype(int), 0, count - 1)
        index[fine < -_SHOWN_LIMIT_M] = 0
        coarse = np.bincount(index, weights=self.histogram, minlength=count)
        centres = (-_SHOWN_LIMIT_M + (np.arange(count) + 0.5) * _SHOWN_BIN_M) * 1000
        shares = coarse / self.measured_pixels
        return [round(float(x), 1) for x in centres], [round(float(x), 6) for x in shares]

    def load(self) -> ErrorTally:
        """The tally itself, see `FiledTally.load`."""
        return self

    def filed(self, file: ArrayFile) -> FiledTally:
        """The tally with its histogram moved into a file.

        Raises:
            ToolkitError: the disk is full.
        """
        counts = np.zeros(0, np.int64) if self.histogram is None else self.histogram
        smallest = np.min_scalar_type(int(counts.max(initial=0)))
        return FiledTally(
            self.truth_pixels,
            self.measured_pixels,
            self.sum_abs,
            self.sum_square,
            file.put(counts.astype(smallest)),
        )


@dataclass(frozen=True, eq=False, slots=True)
class FiledTally:
    """An `ErrorTally` of one frame with its histogram in a file."""

    truth_pixels: int
    measured_pixels: int
    sum_abs: float
    sum_square: float
    histogram: FiledArray

    def load(self) -> ErrorTally:
        """The tally, its histogram read from the file."""
        counts = np.asarray(self.histogram, dtype=np.int64)
        return ErrorTally(
            self.truth_pixels,
            self.measured_pixels,
            self.sum_abs,
            self.sum_square,
            counts if len(counts) else None,
        )


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
    limits = SensorDepthSettings.current()
    index = np.flatnonzero(contour.own)
    if len(index) < limits.fewest_points:
        return None
    if len(index) > _LARGEST_SAMPLE:
        index = index[np.linspace(0, len(index) - 1, _LARGEST_SAMPLE).round().astype(int)]
    normals = contour.normals[index]
    offsets = np.arange(-_REACH_PX, _REACH_PX + _STEP_PX / 2, _STEP_PX)
    at = contour.points[index][:, None] + offsets[:, None] * normals[:, None]
    measured, label = (_sampled(image, at) for image in (sensor, rendered))
    expected = np.where((offsets < 0) & (label > 0), label, contour.depth[index][:, None])
    near = np.abs(measured - expected) < limits.tolerance_m
    boundary, agreement = _boundaries(near, offsets)
    # A profile without a reading does not show where the object ends.
    inner = near[:, offsets <= -_REACH_PX / 2].mean(axis=1) > 0.5
    use = inner & (agreement >= limits.clear) & (np.abs(boundary) < _REACH_PX - 1)
    if use.sum() < limits.fewest_points or use.mean() < 0.3:
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
    limits = SensorDepthSettings.current()
    A = np.concatenate([np.ones((len(normals), 1)), normals], axis=1)
    weights = np.ones(len(A))
    solution = np.zeros(3)
    scale = limits.largest_spread_px
    for _ in range(15):
        M = (A * weights[:, None]).T @ A
        if np.linalg.eigvalsh(M / weights.sum())[0] < 0.05:
            return None
        solution = np.linalg.solve(M, (A * weights[:, None]).T @ boundary)
        residual = np.abs(boundary - A @ solution)
        scale = max(1.4826 * float(np.median(residual)), _STEP_PX)
        weights = 1 / (1 + (residual / scale) ** 2)
    if scale > limits.largest_spread_px:
        return None
    # Neighbouring boundaries are correlated over some pixels: count a quarter of them.
    variance = scale**2 * np.linalg.inv((A * weights[:, None]).T @ A / 4)
    return DepthShift(
        float(solution[1]),
        float(solution[2]),
        float(np.sqrt(np.linalg.eigvalsh(variance[1:, 1:])[-1])),
        len(A),
    )
