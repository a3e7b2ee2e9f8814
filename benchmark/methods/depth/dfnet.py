"""DFNet (Fang et al., RA-L 2022): configuration, network, restorer.

The paper does not state the kernel sizes. The sizes used here give the published number of
parameters, 1.251 million.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from benchmark.methods.network import (
    COMPACT_SIZE,
    NetworkRestorer,
    Prediction,
    coarse_depth,
    in_metres,
    network_depth,
    network_of,
    padded_to,
    precisely,
    relative_color,
)
from benchmark.methods.registry import MethodOptions

_LEVELS = 4

_BOTTLENECK = 4  # channels of a dense layer's first convolution, per channel that it adds


@dataclass(frozen=True, kw_only=True)
class DFNetConfig:
    """DFNet; the defaults are the published network.

    Attributes:
        channels: between the blocks.
        layers, growth: of a dense block: how many layers, and the channels that each adds.
        near, far: metres; what the sensor measured outside counts as not measured.
        outlier: what lies farther than so many standard deviations from the mean of the image's
            depths counts as not measured.
        relative: whether input and output depth are relative to what the sensor
            measured (`benchmark.methods.network`). The published network works in metres.
        input_size: (width, height) of the images.
    """

    channels: int = 64
    layers: int = 5
    growth: int = 12
    near: float = 0.3
    far: float = 1.5
    outlier: float = 10.0
    relative: bool = False
    input_size: tuple[int, int] = (320, 240)


PRESETS = {
    "published": DFNetConfig(),
    "compact": DFNetConfig(channels=32, layers=4, relative=True, input_size=COMPACT_SIZE),
}


class DFNetwork(nn.Module):
    """`network(color, depth)` to `Prediction`: depth alone."""

    def __init__(self, config: DFNetConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or DFNetConfig()
        c = config.channels
        self.stem = _unit(4, c, 3)
        self.skips = nn.ModuleList(Block(c, config) for _ in range(_LEVELS))
        self.encoders = nn.ModuleList(Block(c, config) for _ in range(_LEVELS))
        self.downs = nn.ModuleList(_unit(c, c, 3, stride=2) for _ in range(_LEVELS))
        self.middle = Block(c, config)
        self.ups = nn.ModuleList(
            nn.Sequential(_unit(c, 4 * c, 1), nn.PixelShuffle(2)) for _ in range(_LEVELS)
        )
        self.decoders = nn.ModuleList(Block(2 * c, config) for _ in range(_LEVELS))
        head = nn.Conv2d(c, 1, 1)
        if config.relative:  # the answer begins at the sensor's depth
            nn.init.normal_(head.weight, std=0.01)
            head.bias = nn.Parameter(torch.zeros(1))
        self.last = nn.Sequential(_unit(c, c, 1), head)

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
        """
        h, w = depth.shape[-2:]
        color, depth = padded_to(color, 1 << _LEVELS), padded_to(depth, 1 << _LEVELS)
        depth = believable(depth, self.config)
        measured = depth
        if self.config.relative:
            color, depth = relative_color(color), network_depth(depth)
        depths = [depth]
        for _ in range(_LEVELS):
            depths.append(interpolate(depths[-1], scale_factor=0.5, mode="nearest"))
        features = precisely(self.stem, torch.cat([color, depth], dim=1))
        kept = []
        for level in range(_LEVELS):
            kept.append(self.skips[level](features, depths[level]))
            features = self.downs[level](self.encoders[level](features, depths[level]))
        features = self.middle(features, depths[_LEVELS])
        for level in reversed(range(_LEVELS)):
            features = torch.cat([self.ups[level](features), kept[level]], dim=1)
            features = self.decoders[level](features, depths[level])
        restored = precisely(self.last, features)
        if self.config.relative:
            restored = in_metres(coarse_depth(measured), restored)
        return Prediction(restored[..., :h, :w])


class Block(nn.Module):
    """Convolution, dense block that sees the depth, convolution.

    Args:
        inputs: channels; `config.channels` come out.
        config: sizes.
    """

    def __init__(self, inputs: int, config: DFNetConfig) -> None:
        super().__init__()
        self.before = _unit(inputs, config.growth, 1)
        width = config.growth + 1
        self.layers = nn.ModuleList(
            DenseLayer(width + index * config.growth, config.growth)
            for index in range(config.layers)
        )
        self.after = _unit(width + config.layers * config.growth, config.channels, 3)

    def forward(self, features: Tensor, depth: Tensor) -> Tensor:
        features = torch.cat([self.before(features), depth], dim=1)
        for layer in self.layers:
            features = torch.cat([features, layer(features)], dim=1)
        return self.after(features)


class DenseLayer(nn.Module):
    """What a dense block's layer adds to the channels that it is given."""

    def __init__(self, inputs: int, growth: int) -> None:
        super().__init__()
        inner = _BOTTLENECK * growth
        self.parts = nn.Sequential(
            nn.BatchNorm2d(inputs),
            nn.ReLU(),
            nn.Conv2d(inputs, inner, 1),
            nn.BatchNorm2d(inner),
            nn.ReLU(),
            nn.Conv2d(inner, growth, 3, padding=1),
        )

    def forward(self, features: Tensor) -> Tensor:
        return self.parts(features)


def believable(depth: Tensor, config: DFNetConfig) -> Tensor:
    """(b, 1, h, w) depth with 0 where it is out of range or far from the image's other depths."""
    depth = torch.where((depth >= config.near) & (depth <= config.far), depth, 0.0)
    there = depth > 0
    count = there.sum(dim=(1, 2, 3), keepdim=True).clamp(min=1)
    mean = depth.sum(dim=(1, 2, 3), keepdim=True) / count
    apart = torch.where(there, depth - mean, 0.0)
    spread = (apart.square().sum(dim=(1, 2, 3), keepdim=True) / count).sqrt()
    return torch.where(apart.abs() <= config.outlier * spread, depth, 0.0)


def _unit(inputs: int, outputs: int, kernel: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    )


class DFNet(NetworkRestorer):
    """A small U-Net of dense blocks; settings are those of `DFNetConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config, network = network_of("dfnet", PRESETS, DFNetwork, options)
        super().__init__(network, options, self.config.input_size)
