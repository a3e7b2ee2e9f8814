"""ClearGrasp (Sajjan et al., ICRA 2020): configuration and networks.

Each of the three networks is DeepLabv3+ (Chen et al., ECCV 2018) of stride 8 on a dilated residual
network, DRN-D (Yu et al., CVPR 2017). Keys and shapes match the published weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, normalize

from benchmark.methods.resnet import WIDENED, BasicBlock, Bottleneck, convolution

_CLASSES = (0.5, 0.1)  # dropout of the two that classify


_WIDTHS = (1, 2, 4, 8, 16, 32, 32, 32)  # of the levels, in those of the first

_DILATIONS = (12, 24, 36)

_FINE = 48  # channels that are left of the fine features


class ClearGraspMaps(NamedTuple):
    """What the networks say of every pixel.

    Attributes:
        masks: (b, 2, h, w) logits: other, of a transparent object.
        normals: (b, 3, h, w) unit normals, y up and z towards the camera.
        boundaries: (b, 3, h, w) logits: none, occlusion boundary, contact edge.
    """

    masks: Tensor
    normals: Tensor
    boundaries: Tensor


class ClearGraspNetwork(nn.Module):
    """`network(color)` to `ClearGraspMaps`. The three share nothing; each can be trained alone."""

    def __init__(self, config: ClearGraspConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or ClearGraspConfig()
        self.masks = DeepLab(2, config, _CLASSES)
        self.normals = DeepLab(3, config, None)
        self.boundaries = DeepLab(3, config, _CLASSES)

    def forward(self, color: Tensor) -> ClearGraspMaps:
        """Maps of (b, 3, h, w) RGB in [0, 1]."""
        return ClearGraspMaps(
            self.masks(color),
            normalize(self.normals(color).float(), dim=1),
            self.boundaries(color),
        )


class DRN(nn.Module):
    """Colour to features at an eighth of its size, and finer ones at a quarter.

    Attributes:
        fine_channels, channels: of the two.
    """

    def __init__(self, config: ClearGraspConfig) -> None:
        super().__init__()
        widths = [config.width * factor for factor in _WIDTHS]
        blocks = config.blocks
        out = WIDENED if config.bottleneck else 1
        self.layer0 = _convolutions(3, widths[0], 1, kernel=7)
        self.layer1 = _convolutions(widths[0], widths[0], blocks[0])
        self.layer2 = _convolutions(widths[0], widths[1], blocks[1], stride=2)
        self.layer3 = _residual(widths[1], widths[2], blocks[2], config, stride=2)
        self.layer4 = _residual(out * widths[2], widths[3], blocks[3], config, stride=2)
        self.layer5 = _residual(out * widths[3], widths[4], blocks[4], config, dilation=2)
        self.layer6 = _residual(out * widths[4], widths[5], blocks[5], config, dilation=4)
        self.layer7 = _convolutions(out * widths[5], widths[6], blocks[6], dilation=2)
        self.layer8 = _convolutions(widths[6], widths[7], blocks[7])
        self.fine_channels, self.channels = out * widths[2], widths[7]

    def forward(self, color: Tensor) -> tuple[Tensor, Tensor]:
        """Features (b, channels, h / 8, w / 8), and (b, fine_channels, h / 4, w / 4)."""
        fine = self.layer3(self.layer2(self.layer1(self.layer0(color))))
        features = self.layer6(self.layer5(self.layer4(fine)))
        return self.layer8(self.layer7(features)), fine


def _convolutions(
    inputs: int, outputs: int, count: int, stride: int = 1, dilation: int = 1, kernel: int = 3
) -> nn.Sequential:
    parts: list[nn.Module] = []
    for index in range(count):
        reach = (kernel, 1 if index else stride, dilation)
        parts += convolution(outputs if index else inputs, outputs, *reach)
    return nn.Sequential(*parts)


def _residual(
    inputs: int,
    width: int,
    count: int,
    config: ClearGraspConfig,
    stride: int = 1,
    dilation: int = 1,
) -> nn.Sequential:
    block = Bottleneck if config.bottleneck else BasicBlock
    outputs = WIDENED * width if config.bottleneck else width
    return nn.Sequential(
        block(inputs, width, stride, dilation),
        *(block(outputs, width, 1, dilation) for _ in range(count - 1)),
    )


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
            nn.AdaptiveAvgPool2d(1), *convolution(inputs, channels, 1)
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
            *convolution(channels + _FINE, channels),
            nn.Dropout(first),
            *convolution(channels, channels),
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


@dataclass(frozen=True, kw_only=True)
class ClearGraspConfig:
    """ClearGrasp; the defaults are the published networks.

    Attributes:
        mask: which measurements are dropped. `predicted` asks the network for the pixels of
            transparent objects, as published; `given` those that the method receives, which are of
            transparent and specular objects.
        grow_px: by how many pixels of the optimised image the mask is widened.
        width: channels of the first layer of a backbone; the last ones have 32 times as many.
        bottleneck: whether its blocks have three convolutions (DRN-D-54) or two.
        blocks: of its eight levels.
        head_channels: of what follows the backbone.
        input_size: (width, height) of the images that the networks see.
        depth_size: (width, height) of the image whose depth is optimised.
    """

    mask: Literal["predicted", "given"] = "predicted"
    grow_px: int = 2
    width: int = 16
    bottleneck: bool = True
    blocks: tuple[int, int, int, int, int, int, int, int] = (1, 1, 3, 4, 6, 3, 1, 1)
    head_channels: int = 256
    input_size: tuple[int, int] = (256, 256)
    depth_size: tuple[int, int] = (256, 144)


PRESETS = {
    "published": ClearGraspConfig(),
    "compact": ClearGraspConfig(
        width=8, bottleneck=False, blocks=(1, 1, 2, 2, 2, 2, 1, 1), head_channels=64
    ),
}
