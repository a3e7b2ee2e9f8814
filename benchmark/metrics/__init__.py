"""Depth metrics: pure functions, an accumulator, confidence intervals, significance."""

from benchmark.data.frame import nearest_indices, resize_nearest
from benchmark.metrics.depth.accumulate import DepthMetrics
from benchmark.metrics.depth.depth_numpy import coverage, delta, depth_errors, mae, rel, rmse
from benchmark.metrics.depth.tally import NAMES, THRESHOLDS, Errors, Missing

__all__ = [
    "NAMES",
    "THRESHOLDS",
    "DepthMetrics",
    "Errors",
    "Missing",
    "coverage",
    "delta",
    "depth_errors",
    "mae",
    "nearest_indices",
    "rel",
    "resize_nearest",
    "rmse",
]
