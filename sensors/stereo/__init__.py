"""Depth from a pair of infrared images, as the sensor computes it."""

from sensors.stereo.matcher import (
    MATCHERS,
    StereoMatcher,
    disparity_to_depth,
    make_matcher,
)
from sensors.stereo.options import Backend, Cost, LocalMatcherOptions, Subpixel

__all__ = [
    "MATCHERS",
    "Backend",
    "Cost",
    "LocalMatcherOptions",
    "StereoMatcher",
    "Subpixel",
    "disparity_to_depth",
    "make_matcher",
]
