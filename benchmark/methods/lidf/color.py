"""What colour says about every pixel and its surroundings."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate, max_pool2d, pad, relu

from benchmark.methods.lidf.config import LIDFConfig
from benchmark.methods.resnet import residual_layer

WINDOW = 8  # pixels, side of the surroundings of a pixel
BINS = 2  # by which it is divided, each way
_CELL = WINDOW // BINS


class ColorNet(nn.Module):
    """A ResNet whose last two levels are dilated instead of coarser: an eighth of the image."""

    def __init__(self, config: LIDFConfig) -> None:
        super().__init__()
        c, blocks = config.channels, config.blocks
        self.conv1 = nn.Conv2d(3, c, 7, 2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(c)
        self.layer1 = residual_layer(c, c, blocks[0])
        self.layer2 = residual_layer(c, 2 * c, blocks[1], stride=2)
        self.layer3 = residual_layer(2 * c, 4 * c, blocks[2], dilation=2)
        self.layer4 = residual_layer(4 * c, 8 * c, blocks[3], dilation=4)
        self.last = nn.Conv2d(8 * c, config.color_features, 1)

    def forward(self, color: Tensor) -> Tensor:
        """(b, features, h, w) of (b, 3, h, w) colour, normalised."""
        features = relu(self.bn1(self.conv1(color)))
        features = max_pool2d(features, 3, 2, padding=1)
        for layer in (self.layer1, self.layer2, self.layer3, self.layer4, self.last):
            features = layer(features)
        size = color.shape[-2:]
        return interpolate(features, size=size, mode="bilinear", align_corners=False)


def cell_means(features: Tensor) -> Tensor:
    """Means over the cells that pixels' surroundings consist of.

    This is ROIAlign (He et al., ICCV 2017, aligned) of the window of 8x8 pixels that begins four
    pixels above and left of a pixel, in 2x2 bins: the window has whole coordinates, so that its
    samples lie on pixels, and a bin is the mean of 4x4 of them. Beyond the edges of the image its
    outermost pixels go on.

    Args:
        features: (b, c, h, w).

    Returns:
        (b, c, h + 4, w + 4), of which `surroundings` takes four for every pixel.
    """
    before, after = WINDOW // 2, WINDOW - WINDOW // 2 - 1
    return avg_pool2d(pad(features, (before, after, before, after), "replicate"), _CELL, 1)


def surroundings(means: Tensor, pixels: Tensor) -> Tensor:
    """Features of the surroundings of pixels.

    Args:
        means: (b, c, h + 4, w + 4), from `cell_means`.
        pixels: (r,) indices into the flat batch of h x w pixels.

    Returns:
        (r, 4 c): of each channel the four bins, row by row.
    """
    b, c, h, w = means.shape
    reach = WINDOW - _CELL
    image, row, column = places(pixels, h - reach, w - reach)
    flat = means.permute(0, 2, 3, 1).reshape(b * h * w, c)
    start = (image * h + row) * w + column
    bins = [flat[start + (i * w + j) * _CELL] for i in range(BINS) for j in range(BINS)]
    return torch.stack(bins, dim=2).flatten(1)


def places(pixels: Tensor, h: int, w: int) -> tuple[Tensor, Tensor, Tensor]:
    """Image, row and column of indices into a flat batch of h x w pixels."""
    return pixels // (h * w), pixels // w % h, pixels % w
