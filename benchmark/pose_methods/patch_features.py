"""Colour features of an object's pixels: a ResNet with pyramid pooling (Zhao et al., CVPR 2017).

The form that SPD gives DenseFusion's: four pooled levels of a quarter of the channels each, and
three doublings of resolution back to that of the patch.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, relu

from benchmark.methods.resnet import residual_layer
from benchmark.pointnet import at

_IMAGENET_MEAN, _IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class PatchFeatures(nn.Module):
    """Colour (b, 3, s, s) in [0, 1] to features (b, `outputs`, n) at n pixels of the patch.

    Args:
        width: channels of the first layer of the ResNet; 64 for ResNet-18.
        blocks: residual blocks of its four layers.
        bins: sides of the pooled grids.
        decoder: channels after pooling and after each doubling but the last, and of the last.
        outputs: channels.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        *,
        width: int = 64,
        blocks: Sequence[int] = (2, 2, 2, 2),
        bins: Sequence[int] = (1, 2, 3, 6),
        decoder: Sequence[int] = (256, 64, 64, 32),
        outputs: int = 64,
    ) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = residual_layer(width, width, blocks[0])
        self.layer2 = residual_layer(width, 2 * width, blocks[1], stride=2)
        # Dilated instead of strided: an eighth of the resolution is left.
        self.layer3 = residual_layer(2 * width, 4 * width, blocks[2], dilation=2)
        self.layer4 = residual_layer(4 * width, 8 * width, blocks[3], dilation=4)
        deep = 8 * width
        self.levels = nn.ModuleList(
            nn.Sequential(
                nn.AdaptiveAvgPool2d(b), nn.Conv2d(deep, deep // len(bins), 1, bias=False)
            )
            for b in bins
        )
        channels = deep + len(bins) * (deep // len(bins))
        self.up = nn.ModuleList()
        for channel in decoder[:-1]:
            self.up.append(nn.Sequential(nn.Conv2d(channels, channel, 3, padding=1), nn.PReLU()))
            channels = channel
        self.final = nn.Conv2d(channels, decoder[-1], 1)
        self.each = nn.Sequential(nn.Conv1d(decoder[-1], outputs, 1), nn.ReLU())
        self.outputs = outputs
        self.register_buffer("mean", torch.tensor(_IMAGENET_MEAN)[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(_IMAGENET_STD)[:, None, None], persistent=False)

    def forward(self, color: Tensor, pixels: Tensor) -> Tensor:
        """Features (b, c, n) at pixels (b, n), row * s + column."""
        x = (color - self.mean) / self.std
        x = self.pool(relu(self.bn1(self.conv1(x))))
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        size = x.shape[-2:]
        pooled = [interpolate(level(x), size, mode="bilinear") for level in self.levels]
        x = torch.cat([x, *(relu(p) for p in pooled)], dim=1)
        for up in self.up:
            x = up(interpolate(x, scale_factor=2.0, mode="bilinear"))
        # The last layer at the pixels that count alone: the same numbers for less work.
        features = at(x.flatten(2), pixels)
        return self.each(self.final(features[..., None])[..., 0])
