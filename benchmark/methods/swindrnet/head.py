"""The decoder of SwinDRNet: UPerNet (Xiao et al., ECCV 2018), a pyramid of means and of levels.

Keys and shapes are those of the published weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from benchmark.methods.network import precisely


class ConvUnit(nn.Module):
    """Convolution, batch normalisation, ReLU; a stride of 1 keeps the size."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
        self.bn = nn.BatchNorm2d(outputs)

    def forward(self, features: Tensor) -> Tensor:
        return nn.functional.relu(self.bn(self.conv(features)))


class UPerHead(nn.Module):
    """Four levels to one map at the resolution of the first.

    Args:
        inputs: channels of the levels.
        channels: of the decoder.
        outputs: channels of the map.
        pool_scales: sides of the pooled pyramid of the last level.
        dropout: chance of a channel to be left out before the last convolution in training.
    """

    def __init__(
        self,
        inputs: Sequence[int],
        channels: int,
        outputs: int,
        pool_scales: Sequence[int],
        dropout: float,
    ) -> None:
        super().__init__()
        *lower, top = inputs
        self.psp_modules = nn.ModuleList(
            nn.Sequential(nn.AdaptiveAvgPool2d(scale), ConvUnit(top, channels, 1))
            for scale in pool_scales
        )
        self.bottleneck = ConvUnit(top + len(pool_scales) * channels, channels, 3)
        self.lateral_convs = nn.ModuleList(ConvUnit(width, channels, 1) for width in lower)
        self.fpn_convs = nn.ModuleList(ConvUnit(channels, channels, 3) for _ in lower)
        self.fpn_bottleneck = ConvUnit(len(inputs) * channels, channels, 3)
        self.dropout = nn.Dropout2d(dropout)
        self.conv_seg = nn.Conv2d(channels, outputs, 1)
        nn.init.normal_(self.conv_seg.weight, std=0.01)
        self.conv_seg.bias = nn.Parameter(torch.zeros(outputs))

    def forward(self, levels: Sequence[Tensor]) -> Tensor:
        """(b, c, h, w) levels, each half the size of the one before, to (b, outputs, h, w)."""
        top = levels[-1]
        means = [enlarged(module(top), top) for module in self.psp_modules]
        features = [conv(level) for conv, level in zip(self.lateral_convs, levels, strict=False)]
        features.append(self.bottleneck(torch.cat([top, *means], dim=1)))
        for index in range(len(features) - 1, 0, -1):
            below = features[index - 1]
            features[index - 1] = below + enlarged(features[index], below)
        for index, conv in enumerate(self.fpn_convs):
            features[index] = conv(features[index])
        features = [features[0], *(enlarged(feature, features[0]) for feature in features[1:])]
        fused = self.dropout(self.fpn_bottleneck(torch.cat(features, dim=1)))
        return precisely(self.conv_seg, fused)


def enlarged(features: Tensor, like: Tensor) -> Tensor:
    """Bilinear enlargement to the size of `like`, corners not aligned."""
    if features.shape[-2:] == like.shape[-2:]:
        return features
    return interpolate(features, size=like.shape[-2:], mode="bilinear", align_corners=False)
