"""Depth aligned to another camera's image."""

from sensors.align.depth import align_depth

__all__ = ["align_depth"]
