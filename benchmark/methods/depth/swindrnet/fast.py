"""SwinDRNet in an equivalent form that is faster on a CPU.

Batch normalisation is merged into the convolution before it. Where the decoder convolves upsampled
features, the products over channels are formed before the upsampling, with a quarter of the pixels
or less, because both are linear. Linear layers become convolutions, which oneDNN runs several times
as fast on some processors.
"""

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d, interpolate, linear, relu

from benchmark.methods.depth.swindrnet import fusion_decoder, swindrnet_network
from benchmark.methods.network import Prediction

_TAPS = 3  # side of the convolutions

_FEW = 20_481  # numbers of an image below which torch does not give a convolution to oneDNN


class FastSwinDRNetwork(nn.Module):
    """The same function as a trained `SwinDRNetwork`, which it takes apart: use that no more."""

    def __init__(self, network: swindrnet_network.SwinDRNetwork) -> None:
        super().__init__()
        network.eval().requires_grad_(False)
        self.depth_head = FastHead(network.decode_head_depth_restoration)
        del network.decode_head_depth_restoration
        self.confidence_head = None
        if network.config.confidence:
            self.confidence_head = FastHead(network.decode_head_confidence)
            del network.decode_head_confidence
        _convolve_linear_layers(network)
        self.streams = network

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        found = self.streams.features(color, depth)
        confidence = None if self.confidence_head is None else self.confidence_head(found.levels)
        return self.streams.answer(depth, found.details, self.depth_head(found.levels), confidence)


class FastHead(nn.Module):
    """The same function as a trained `UPerHead`."""

    def __init__(self, head: fusion_decoder.UPerHead) -> None:
        super().__init__()
        channels = head.conv_seg.in_channels
        self.pools = nn.ModuleList(module[0] for module in head.psp_modules)  # type: ignore[index]
        self.pool_convs = _folded_all(module[1] for module in head.psp_modules)  # type: ignore[index]
        self.bottleneck = PyramidConv(head.bottleneck, channels, enlargements=len(self.pools))
        self.lateral_convs = _folded_all(head.lateral_convs)
        self.fpn_convs = _folded_all(head.fpn_convs)
        self.fpn_bottleneck = PyramidConv(
            head.fpn_bottleneck, channels, enlargements=len(head.lateral_convs)
        )
        self.conv_seg = head.conv_seg

    def forward(self, levels: Sequence[Tensor]) -> Tensor:
        top = levels[-1]
        means = [conv(pool(top)) for pool, conv in zip(self.pools, self.pool_convs, strict=True)]
        features = [conv(level) for conv, level in zip(self.lateral_convs, levels, strict=False)]
        features.append(self.bottleneck(top, means))
        for index in range(len(features) - 1, 0, -1):
            below = features[index - 1]
            features[index - 1] = below + fusion_decoder.enlarged(features[index], below)
        for index, conv in enumerate(self.fpn_convs):
            features[index] = conv(features[index])
        return self.conv_seg(self.fpn_bottleneck(features[0], features[1:]))


class FoldedConv(nn.Module):
    """Convolution and ReLU."""

    weight: Tensor
    bias: Tensor

    def __init__(self, weight: Tensor, bias: Tensor) -> None:
        super().__init__()
        self.register_buffer("weight", weight.contiguous(memory_format=torch.channels_last))
        self.register_buffer("bias", bias)

    def forward(self, features: Tensor) -> Tensor:
        side = self.weight.shape[-1]
        if side == 1:
            pixels = _pointwise(features.permute(0, 2, 3, 1), self.weight, self.bias)
            return relu(pixels).permute(0, 3, 1, 2)
        return relu(conv2d(features, self.weight, self.bias, padding=side // 2))


class PyramidConv(nn.Module):
    """A 3x3 convolution, normalisation and ReLU of a map and of others enlarged to its size.

    Args:
        unit: the convolution of all of them, one after the other along the channels.
        channels: of each of the others.
        enlargements: how many others there are; they come last.
    """

    weight: Tensor
    bias: Tensor

    def __init__(self, unit: fusion_decoder.ConvUnit, channels: int, enlargements: int) -> None:
        super().__init__()
        weight, bias = folded(unit)
        whole = weight.shape[1] - enlargements * channels
        own, *others = weight.split([whole] + [channels] * enlargements, dim=1)
        self.register_buffer("weight", own.contiguous(memory_format=torch.channels_last))
        self.register_buffer("bias", bias)
        self.others = nn.ModuleList(EnlargedConv(other) for other in others)

    def forward(self, features: Tensor, smaller: Sequence[Tensor]) -> Tensor:
        total = conv2d(features, self.weight, self.bias, padding=1)
        for conv, small in zip(self.others, smaller, strict=True):
            total += conv(small, features.shape[-2], features.shape[-1])
        return relu(total)


class EnlargedConv(nn.Module):
    """`conv2d(enlarged(features), weight, padding=1)` without enlarging all of the features."""

    weight: Tensor

    def __init__(self, weight: Tensor) -> None:
        super().__init__()
        outputs, inputs = weight.shape[:2]
        # For each row of taps one product over channels, for its three taps at once.
        rows = weight.permute(2, 3, 0, 1).reshape(_TAPS, _TAPS * outputs, inputs, 1, 1)
        self.register_buffer("weight", rows.contiguous())

    def forward(self, features: Tensor, height: int, width: int) -> Tensor:
        b, _, h, w = features.shape
        across = _taps_of_enlarged(w, width, features)  # (width, w * taps)
        down = _taps_of_enlarged(h, height, features)  # (height, h * taps)
        rows = []
        for weight in self.weight:
            products = _pointwise(features.permute(0, 2, 3, 1), weight)
            rows.append(across @ products.reshape(b, h, w * _TAPS, -1))
        of_rows = torch.stack(rows, dim=2).reshape(b, h * _TAPS, -1)
        return (down @ of_rows).reshape(b, height, width, -1).permute(0, 3, 1, 2)


class PointwiseLinear(nn.Module):
    """A linear layer as a convolution with a kernel of one pixel."""

    weight: Tensor
    bias: Tensor | None

    def __init__(self, layer: nn.Linear) -> None:
        super().__init__()
        self.register_buffer("weight", layer.weight[:, :, None, None])
        self.register_buffer("bias", layer.bias)

    def forward(self, tokens: Tensor) -> Tensor:
        pixels = tokens.reshape(1, -1, 1, tokens.shape[-1])
        return _pointwise(pixels, self.weight, self.bias).reshape(*tokens.shape[:-1], -1)


def folded(unit: fusion_decoder.ConvUnit) -> tuple[Tensor, Tensor]:
    """Weight and bias of the convolution that is a trained unit's convolution and normalisation."""
    bn = unit.bn
    mean, variance = bn.running_mean, bn.running_var
    assert mean is not None and variance is not None  # as batch normalisation has by default
    scale = bn.weight * (variance + bn.eps).rsqrt()
    return unit.conv.weight * scale[:, None, None, None], bn.bias - mean * scale


def _folded_all(units: Iterable[nn.Module]) -> nn.ModuleList:
    return nn.ModuleList(
        FoldedConv(*folded(u)) for u in units if isinstance(u, fusion_decoder.ConvUnit)
    )


def _pointwise(pixels: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """(b, h, w, c) times (outputs, c, 1, 1), as (b, h, w, outputs)."""
    if pixels.numel() < _FEW:
        return linear(pixels, weight[:, :, 0, 0], bias)
    return conv2d(pixels.permute(0, 3, 1, 2), weight, bias).permute(0, 2, 3, 1)


def _taps_of_enlarged(small: int, large: int, like: Tensor) -> Tensor:
    """What each pixel's three taps weigh the pixels of a row before its enlargement with.

    Returns:
        (large, small * 3): pixel p of the large row, pixel q of the small one, tap t: the share of
        q in pixel p + t - 1 of the enlarged row, 0 beyond its ends.
    """
    identity = torch.eye(small, dtype=like.dtype, device=like.device)[None]
    shares = interpolate(identity, size=large, mode="linear", align_corners=False)[0].T
    shares = nn.functional.pad(shares, (0, 0, 1, 1))
    return torch.stack([shares[tap : tap + large] for tap in range(_TAPS)], 2).flatten(1)


def _convolve_linear_layers(module: nn.Module) -> None:
    for name, child in list(module.named_children()):
        if isinstance(child, nn.Linear):
            setattr(module, name, PointwiseLinear(child))
        else:
            _convolve_linear_layers(child)
