"""Sensor depth against labels: residuals of the labels, errors of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.array_file import ArrayFile, FiledArray

FEWEST_PIXELS = 50
# Depth sensors mix foreground and background within some pixels of an outline.
EDGE_MARGIN_PX = 3
HISTOGRAM_LIMIT_M = 0.5
HISTOGRAM_BIN_M = 0.0005
_BINS = round(2 * HISTOGRAM_LIMIT_M / HISTOGRAM_BIN_M)


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


def depth_residual(
    rendered: NDArray[np.floating], sensor: NDArray[np.floating], mask: NDArray[np.bool_]
) -> DepthResidual | None:
    """Robust statistics of rendered minus sensor depth, away from the outline.

    Args:
        rendered, sensor: (H, W) z-depth in metres, 0 = none.
        mask: (H, W) pixels that show the object.

    Returns:
        None if fewer than `FEWEST_PIXELS` pixels have both.
    """
    size = 2 * EDGE_MARGIN_PX + 1
    inner = cv2.erode(
        mask.astype(np.uint8),
        cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    ).astype(bool)
    use = inner & (rendered > 0) & (sensor > 0)
    count = int(use.sum())
    if count < FEWEST_PIXELS:
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
