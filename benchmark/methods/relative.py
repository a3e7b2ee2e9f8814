"""Depth told to a network relative to what the sensor measured in the same image.

A scene that is twice as large and twice as far looks the same. Relative depth is the same for
both, and it is near 0, so that a network need not learn to tell 0.70 m from 0.71 m by what
normalisation leaves of large numbers.
"""

from __future__ import annotations

from torch import Tensor

_SPAN = 0.2  # what counts as 1: a tabletop's depths differ by about this share of their mean


def mean_depth(depth: Tensor) -> Tensor:
    """(b, 1, 1, 1) mean of each image's measured depths (b, 1, h, w), metres; 1 m without any."""
    measured = (depth > 0).sum(dim=(1, 2, 3), keepdim=True)
    mean = depth.sum(dim=(1, 2, 3), keepdim=True) / measured.clamp(min=1)
    return mean.masked_fill(measured == 0, 1.0)


def relative_to(mean: Tensor, depth: Tensor) -> Tensor:
    """Metres (b, 1, h, w) as (depth / mean - 1) / 0.2; what was not measured is -5."""
    return (depth / mean - 1) / _SPAN


def in_metres(mean: Tensor, relative: Tensor) -> Tensor:
    """The inverse of `relative_to`."""
    return mean * (1 + _SPAN * relative)
