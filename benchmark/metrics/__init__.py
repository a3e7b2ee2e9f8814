"""Depth metrics: pure functions, an accumulator, confidence intervals, significance."""
