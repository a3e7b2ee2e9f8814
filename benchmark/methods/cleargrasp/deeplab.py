"""One of ClearGrasp's three networks: DeepLabv3+ (Chen et al., ECCV 2018) of stride 8.

Keys and shapes are those of the weights that ClearGrasp's authors publish.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from benchmark.methods.cleargrasp.config import ClearGraspConfig
from benchmark.methods.cleargrasp.drn import DRN

_DILATIONS = (12, 24, 36)
_FINE = 48  # channels that are left of the fine features


class DeepLab(nn.Module):
    """(b, 3, h, w) colour in [0, 1] to (b, outputs, h, w), linear.

    Args:
        outputs: channels.
        config: sizes.
        dropout: chances in training to leave a channel out, after the last two convolutions;
            None for networks that have nothing there.
    """

    def __init__(
        self, outputs: int, config: ClearGraspConfig, dropout: tuple[float, float] | None
    ) -> None:
        super().__init__()
        self.backbone = DRN(config)
        self.aspp = Pyramid(self.backbone.channels, config.head_channels)
        self.decoder = Decoder(self.backbone.fine_channels, config.head_channels, outputs, dropout)
        _begin(self)

    def forward(self, color: Tensor) -> Tensor:
        features, fine = self.backbone(color)
        return _sized(self.decoder(self.aspp(features), fine), color)


class Pyramid(nn.Module):
    """Dilated convolutions of several reaches and the mean of the image, side by side."""

    def __init__(self, inputs: int, channels: int) -> None:
        super().__init__()
        self.aspp1 = Reach(inputs, channels, 1, 1)
        self.aspp2 = Reach(inputs, channels, 3, _DILATIONS[0])
        self.aspp3 = Reach(inputs, channels, 3, _DILATIONS[1])
        self.aspp4 = Reach(inputs, channels, 3, _DILATIONS[2])
        self.global_avg_pool = nn.Sequential(
            nn.AdaptiveAvgPool2d(1),
            nn.Conv2d(inputs, channels, 1, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(),
        )
        self.conv1 = nn.Conv2d(5 * channels, channels, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(channels)
        self.dropout = nn.Dropout(0.5)

    def forward(self, features: Tensor) -> Tensor:
        parts = [aspp(features) for aspp in (self.aspp1, self.aspp2, self.aspp3, self.aspp4)]
        parts.append(self.global_avg_pool(features).expand_as(parts[0]))
        return self.dropout(self.bn1(self.conv1(torch.cat(parts, dim=1))).relu())


class Reach(nn.Module):
    """One dilated convolution of the pyramid."""

    def __init__(self, inputs: int, channels: int, kernel: int, dilation: int) -> None:
        super().__init__()
        self.atrous_conv = nn.Conv2d(
            inputs,
            channels,
            kernel,
            padding=dilation * (kernel // 2),
            dilation=dilation,
            bias=False,
        )
        self.bn = nn.BatchNorm2d(channels)

    def forward(self, features: Tensor) -> Tensor:
        return self.bn(self.atrous_conv(features)).relu()


class Decoder(nn.Module):
    """Brings in the fine features, at whose size it answers."""

    def __init__(
        self, fine: int, channels: int, outputs: int, dropout: tuple[float, float] | None
    ) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(fine, _FINE, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(_FINE)
        first, second = dropout or (0.0, 0.0)
        parts: list[nn.Module] = [
            nn.Conv2d(channels + _FINE, channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(),
            nn.Dropout(first),
            nn.Conv2d(channels, channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(),
        ]
        if dropout is not None:  # keys count it
            parts.append(nn.Dropout(second))
        self.last_conv = nn.Sequential(*parts, nn.Conv2d(channels, outputs, 1))

    def forward(self, features: Tensor, fine: Tensor) -> Tensor:
        fine = self.bn1(self.conv1(fine)).relu()
        return self.last_conv(torch.cat([_sized(features, fine), fine], dim=1))


def _sized(images: Tensor, like: Tensor) -> Tensor:
    return interpolate(images, size=like.shape[-2:], mode="bilinear", align_corners=True)


def _begin(network: nn.Module) -> None:
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight)
            if module.bias is not None:
                nn.init.zeros_(module.bias)
