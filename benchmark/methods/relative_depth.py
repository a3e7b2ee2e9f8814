"""Relative depth and colour: what networks see and say does not depend on the scene's scale.

The input is relative to the mean depth of the image. The output is relative to the sensor's depth
at low resolution, with holes filled from their surroundings: an output of 0 repeats the sensor.
"""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

_SPAN = 0.2  # what counts as 1: a tabletop's depths differ by about this share of their mean

# Of the mean: farther measurements are most often wrong matches. Far walls are among them, too; an
# answer about these has farther to go.
_FARTHEST = 2.5

_CONTRAST = 0.25

_HALVINGS = 9  # of the map at a quarter of the size, to one pixel of images of up to 2048


def mean_depth(depth: Tensor) -> Tensor:
    """(b, 1, 1, 1) mean of each image's measured depths (b, 1, h, w), metres; 1 m without any."""
    measured = (depth > 0).sum(dim=(1, 2, 3), keepdim=True)
    mean = depth.sum(dim=(1, 2, 3), keepdim=True) / measured.clamp(min=1)
    return mean.masked_fill(measured == 0, 1.0)


def coarse_depth(depth: Tensor) -> Tensor:
    """(b, 1, h, w) metres everywhere: means over 4x4 pixels of what was measured, enlarged.

    What was measured beyond 2.5 times the image's mean is left out: one wrong match would fill a
    whole hole. A pixel of that map without any measurement takes the mean of a region around it
    that has one, the smallest of 8x8, 16x16 and so on; 1 m in an image without any.
    """
    size = depth.shape[-2:]
    filled = mean_depth(depth)
    known = ((depth > 0) & (depth < _FARTHEST * filled)).to(depth.dtype)
    sums, counts = [_halved(_halved(depth * known))], [_halved(_halved(known))]
    for _ in range(_HALVINGS):
        sums.append(_halved(sums[-1]))
        counts.append(_halved(counts[-1]))
    for total, count in zip(reversed(sums), reversed(counts), strict=True):
        around = interpolate(filled, size=total.shape[-2:], mode="bilinear", align_corners=False)
        filled = (total / count.clamp(min=1e-9)).where(count > 0, around)
    return interpolate(filled, size=size, mode="bilinear", align_corners=False)


def network_depth(depth: Tensor) -> Tensor:
    """(b, 1, h, w) network input from depth in metres: relative to its mean, at most 2.5 times the
    mean."""
    mean = mean_depth(depth)
    return relative_to(mean, torch.minimum(depth, _FARTHEST * mean))


def relative_color(color: Tensor) -> Tensor:
    """(b, 3, h, w) colour in [0, 1] less the image's mean colour, in quarters.

    Most of an image is the table: what stands on it, glass too, is then what differs from 0.
    """
    return (color - color.mean(dim=(2, 3), keepdim=True)) / _CONTRAST


def relative_to(reference: Tensor, depth: Tensor) -> Tensor:
    """Metres (b, 1, h, w) as (depth / reference - 1) / 0.2; what was not measured is -5."""
    return (depth / reference - 1) / _SPAN


def in_metres(reference: Tensor, relative: Tensor) -> Tensor:
    """The inverse of `relative_to`."""
    return reference * (1 + _SPAN * relative)


def _halved(image: Tensor) -> Tensor:
    return avg_pool2d(image, 2, ceil_mode=True, count_include_pad=False)
