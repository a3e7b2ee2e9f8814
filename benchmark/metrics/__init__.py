"""Depth metrics: pure functions, an accumulator, confidence intervals, significance."""

from benchmark.data.frame import nearest_indices, resize_nearest
from benchmark.metrics.depth.accumulate import DepthMetrics
from benchmark.metrics.depth.depth_metrics import (
    coverage,
    delta,
    depth_errors,
    image_errors,
    mae,
    rel,
    rmse,
)
from benchmark.metrics.depth.figures import FIGURES, NAMES, THRESHOLDS, Errors, Figure, Missing

__all__ = [
    "FIGURES",
    "NAMES",
    "THRESHOLDS",
    "DepthMetrics",
    "Errors",
    "Figure",
    "Missing",
    "coverage",
    "delta",
    "depth_errors",
    "image_errors",
    "mae",
    "nearest_indices",
    "rel",
    "resize_nearest",
    "rmse",
]
