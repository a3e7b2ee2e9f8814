"""DFNet (Fang et al., RA-L 2022): configuration, network, restorer.

There are two forms. `paper` is written from the paper, which does not state the kernel sizes; those
here give the published number of parameters, 1.251 million. `released` is the network of the
authors' program (TransCG), with its keys: their weights fit and give their answers.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from benchmark.methods.network import (
    COMPACT_SIZE,
    NetworkRestorer,
    Prediction,
    network_of,
    padded_to,
    precisely,
)
from benchmark.methods.registry import MethodOptions
from benchmark.methods.relative_depth import coarse_depth, in_metres, network_depth, relative_color
from benchmark.methods.resnet import convolution
from std_toolkit.errors import ToolkitError

_LEVELS = 4

_BOTTLENECK = 4  # channels of a dense layer's first convolution, per channel that it adds


@dataclass(frozen=True, kw_only=True)
class DFNetConfig:
    """DFNet; the defaults are the published network.

    Attributes:
        form: `paper` or `released`, see above.
        channels: between the blocks.
        layers, growth: of a dense block: how many layers, and the channels that each adds.
        near, far: metres; what the sensor measured outside counts as not measured.
        outlier: what lies farther than so many standard deviations from the mean of the image's
            depths counts as not measured.
        relative: whether input and output depth are relative to what the sensor
            measured (`benchmark.methods.relative_depth`). The published network works in metres.
        input_size: (width, height) of the images.
    """

    form: Literal["paper", "released"] = "paper"
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


_plain = partial(convolution, bias=True)


class DFNetwork(nn.Module):
    """`network(color, depth)` to `Prediction`: depth alone."""

    def __init__(self, config: DFNetConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or DFNetConfig()
        c = config.channels
        self.stem = convolution(4, c, 3)
        self.skips = nn.ModuleList(Block(c, config) for _ in range(_LEVELS))
        self.encoders = nn.ModuleList(Block(c, config) for _ in range(_LEVELS))
        self.downs = nn.ModuleList(convolution(c, c, 3, stride=2) for _ in range(_LEVELS))
        self.middle = Block(c, config)
        self.ups = nn.ModuleList(
            nn.Sequential(convolution(c, 4 * c, 1), nn.PixelShuffle(2)) for _ in range(_LEVELS)
        )
        self.decoders = nn.ModuleList(Block(2 * c, config) for _ in range(_LEVELS))
        head = nn.Conv2d(c, 1, 1)
        if config.relative:  # the answer begins at the sensor's depth
            nn.init.normal_(head.weight, std=0.01)
            head.bias = nn.Parameter(torch.zeros(1))
        self.last = nn.Sequential(convolution(c, c, 1), head)

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
        self.before = convolution(inputs, config.growth, 1)
        width = config.growth + 1
        self.layers = nn.ModuleList(
            DenseLayer(width + index * config.growth, config.growth)
            for index in range(config.layers)
        )
        self.after = convolution(width + config.layers * config.growth, config.channels, 3)

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


class ReleasedDFNetwork(nn.Module):
    """The authors' network, under their keys; `network(color, depth)` to `Prediction`.

    Its stem halves the resolution, convolutions come before normalisation and activation, and a
    dense block answers with the channels of its last layer.

    Raises:
        ToolkitError: relative depth, which this form does not have.
    """

    def __init__(self, config: DFNetConfig) -> None:
        super().__init__()
        if config.relative:
            raise ToolkitError("form released works in metres", field="relative", value=True)
        self.config = config
        c, k = config.channels, config.growth
        self.first = _plain(4, c, stride=2)
        for level in range(1, _LEVELS + 1):
            last = level == _LEVELS
            for skip in ("",) if last else ("s", ""):
                self.add_module(f"dense{level}{skip}_conv1", _plain(c, c))
                self.add_module(f"dense{level}{skip}", ReleasedBlock(config))
                stride = 1 if skip or last else 2
                self.add_module(f"dense{level}{skip}_conv2", _plain(k, c, stride=stride))
        for level in range(1, _LEVELS + 1):
            self.add_module(f"updense{level}_conv", _plain(c if level == 1 else 2 * c, c))
            self.add_module(f"updense{level}", ReleasedBlock(config))
            self.add_module(f"updense{level}_duc", _SubPixel(k, c))
        self.final = nn.Sequential(*_plain(c, c), nn.Conv2d(c, 1, 1))

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        """Restore depth; see `DFNetwork`."""
        h, w = depth.shape[-2:]
        color, depth = padded_to(color, 1 << _LEVELS), padded_to(depth, 1 << _LEVELS)
        depth = believable(depth, self.config)
        depths = [depth]
        for _ in range(_LEVELS):
            depths.append(interpolate(depths[-1], scale_factor=0.5, mode="nearest"))
        features = precisely(self.first, torch.cat([color, depth], dim=1))
        kept = []
        for level in range(1, _LEVELS):
            kept.append(self._dense(f"dense{level}s", features, depths[level]))
            features = self._dense(f"dense{level}", features, depths[level])
        features = self._dense(f"dense{_LEVELS}", features, depths[_LEVELS])
        for level in range(1, _LEVELS + 1):
            if level > 1:
                features = torch.cat([features, kept[_LEVELS - level]], dim=1)
            name, own = f"updense{level}", depths[_LEVELS + 1 - level]
            features = self.get_submodule(f"{name}_conv")(features)
            features = self.get_submodule(name)(torch.cat([features, own], dim=1))
            features = self.get_submodule(f"{name}_duc")(features)
        restored = precisely(self.final, features)  # negative ones, too, as there
        return Prediction(restored[..., :h, :w])

    def _dense(self, name: str, features: Tensor, depth: Tensor) -> Tensor:
        features = self.get_submodule(f"{name}_conv1")(features)
        features = self.get_submodule(name)(torch.cat([features, depth], dim=1))
        return self.get_submodule(f"{name}_conv2")(features)


class ReleasedBlock(nn.Module):
    """Layers that each see all channels before them; the last one's are the answer."""

    def __init__(self, config: DFNetConfig) -> None:
        super().__init__()
        k = config.growth
        self.layers = nn.ModuleList(
            nn.Sequential(
                *_plain(config.channels + 1 + i * k, _BOTTLENECK * k, kernel=1),
                *_plain(_BOTTLENECK * k, k),
            )
            for i in range(config.layers)
        )

    def forward(self, features: Tensor) -> Tensor:
        added = features
        for layer in self.layers:
            added = layer(features)
            features = torch.cat([features, added], dim=1)
        return added


class _SubPixel(nn.Module):
    """Twice the resolution: the pixels of each 2x2 cell come from channels."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.layer = _plain(inputs, 4 * outputs)
        self.shuffle = nn.PixelShuffle(2)

    def forward(self, features: Tensor) -> Tensor:
        return self.shuffle(self.layer(features))


def dfnet_of(config: DFNetConfig) -> DFNetwork | ReleasedDFNetwork:
    """The network of a configuration.

    Raises:
        ToolkitError: settings that do not go together.
    """
    return ReleasedDFNetwork(config) if config.form == "released" else DFNetwork(config)


def believable(depth: Tensor, config: DFNetConfig) -> Tensor:
    """(b, 1, h, w) depth with 0 where it is out of range or far from the image's other depths."""
    depth = torch.where((depth >= config.near) & (depth <= config.far), depth, 0.0)
    there = depth > 0
    count = there.sum(dim=(1, 2, 3), keepdim=True).clamp(min=1)
    mean = depth.sum(dim=(1, 2, 3), keepdim=True) / count
    apart = torch.where(there, depth - mean, 0.0)
    spread = (apart.square().sum(dim=(1, 2, 3), keepdim=True) / count).sqrt()
    return torch.where(apart.abs() <= config.outlier * spread, depth, 0.0)


class DFNet(NetworkRestorer):
    """A small U-Net of dense blocks; settings are those of `DFNetConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = DFNetConfig

    def __init__(self, options: MethodOptions) -> None:
        self.config, network = network_of("dfnet", PRESETS, dfnet_of, options)
        super().__init__(network, options, self.config.input_size)
