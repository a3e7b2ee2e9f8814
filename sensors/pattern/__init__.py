"""Dot patterns of the sensors' infrared projectors."""

from sensors.pattern.dot_pattern import DotPattern, load_pattern, make_pattern

__all__ = ["DotPattern", "load_pattern", "make_pattern"]
