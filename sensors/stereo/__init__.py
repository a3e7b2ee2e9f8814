"""Depth from a pair of infrared images, as the sensor computes it."""

from sensors.stereo.local_options import Backend, Cost, LocalMatcherOptions, Subpixel
from sensors.stereo.stereo_matcher import (
    MATCHERS,
    StereoMatcher,
    disparity_to_depth,
    make_matcher,
)

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
