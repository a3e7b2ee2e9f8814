"""Depth metrics: pure functions, an accumulator, confidence intervals, significance."""

from benchmark.metrics.accumulate import DepthMetrics
from benchmark.metrics.depth import coverage, delta, depth_errors, mae, rel, rmse
from benchmark.metrics.missing import THRESHOLDS, Missing
from benchmark.metrics.resize import nearest_indices, resize_nearest
from benchmark.metrics.tally import NAMES, Errors

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
