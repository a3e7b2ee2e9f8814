"""SwinDRNet as a restorer: fast inference, and ImageNet weights for training.

Inference uses an equivalent network that is faster on a CPU. Batch normalisation is merged into the
convolution before it. Where the decoder convolves upsampled features, the products over channels
are formed before the upsampling, with a quarter of the pixels or less, because both are linear.
Linear layers become convolutions, which oneDNN runs several times as fast on some processors.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d, interpolate, linear, relu

from benchmark.methods.depth.swindrnet import fusion_decoder, swin, swindrnet_network
from benchmark.methods.network import NetworkRestorer, Prediction, network_of, torch_device
from benchmark.methods.registry import MethodOptions
from benchmark.methods.weights import check_keys, read_weights
from std_toolkit.errors import ToolkitError

_TAPS = 3  # side of the convolutions

_FEW = 20_481  # numbers of an image below which torch does not give a convolution to oneDNN

# Of a classifier, and what does not depend on training.
_UNUSED = re.compile(r"(head|norm)\.|.*(attn_mask|relative_position_index)$")

# From the keys in the files of `transformers` to the published ones.
_RENAMED = (
    (r"^swin\.", ""),
    (r"^embeddings\.patch_embeddings\.projection\.", "patch_embed.proj."),
    (r"^embeddings\.norm\.", "patch_embed.norm."),
    (r"^encoder\.", ""),
    (r"\.layernorm_before\.", ".norm1."),
    (r"\.layernorm_after\.", ".norm2."),
    (r"\.attention\.self\.relative", ".attn.relative"),
    (r"\.attention\.self\.(query|key|value)\.", r".attn.\1."),
    (r"\.attention\.output\.dense\.", ".attn.proj."),
    (r"\.intermediate\.dense\.", ".mlp.fc1."),
    (r"\.output\.dense\.", ".mlp.fc2."),
    (r"^(layernorm|classifier)\.", "head."),
)


class SwinDRNet(NetworkRestorer):
    """Depth and confidence from two Swin transformers; settings are those of `SwinDRNetConfig`.

    The default settings fit the weights that the authors published. On a processor, at full
    precision, it runs in a faster form that gives the same answers (`fast.py`).

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self._options = options
        self.config, network = _network(options)
        device = torch_device(options.device)
        plain = not options.compile and options.precision == "fp32"
        used = FastSwinDRNetwork(network) if plain and device.type == "cpu" else network
        width, height = self.config.input_size
        super().__init__(
            self._wrapped(used),
            options,
            (2 * width, height) if self.config.interleaved else (width, height),
        )

    def skeleton(self) -> nn.Module:
        with torch.device("meta"):
            return self._wrapped(swindrnet_network.SwinDRNetwork(self.config)).eval()

    def plain_network(self) -> nn.Module:
        return self._wrapped(_network(self._options)[1]).eval().requires_grad_(False)

    def _wrapped(self, network: nn.Module) -> nn.Module:
        return Interleaved(network) if self.config.interleaved else network


def _network(
    options: MethodOptions,
) -> tuple[swindrnet_network.SwinDRNetConfig, swindrnet_network.SwinDRNetwork]:
    presets = swindrnet_network.PRESETS
    config, network = network_of("swindrnet", presets, swindrnet_network.SwinDRNetwork, options)
    own = presets[options.preset].input_size
    if options.weights is None and config.input_size != own:
        # Their statistics of batch normalisation are those of one size: at others, objects are
        # decimetres off.
        raise ToolkitError(
            f"the weights that ship are for {own[0]}x{own[1]} alone",
            field="input_size",
            value=f"{config.input_size[0]}x{config.input_size[1]}",
            hint="leave the size away, or give --weights that were trained at this one",
        )
    return config, network


class Interleaved(nn.Module):
    """Restores the even and the odd columns of images as images of half the width.

    Args:
        network: called with colour and depth, as of `NetworkRestorer`.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.halves = network

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        """Images (b, c, h, w) of an even width."""
        found = self.halves(*(_columns_apart(images) for images in (color, depth)))
        depth, *others = found
        rest = (None if part is None else _columns_together(part) for part in others)
        return Prediction(_columns_together(depth), *rest)


def _columns_apart(images: Tensor) -> Tensor:
    """(b, c, h, w) as (2 b, c, h, w / 2): the even columns of all, then the odd ones."""
    return torch.cat([images[..., 0::2], images[..., 1::2]])


def _columns_together(halves: Tensor) -> Tensor:
    """The inverse of `_columns_apart`."""
    return torch.stack(halves.chunk(2), dim=-1).flatten(-2)


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


def load_imagenet(network: swindrnet_network.SwinDRNetwork, path: Path) -> None:
    """Begin both streams with the weights of a Swin that was trained on ImageNet.

    Args:
        network: its norms of the levels, fusion and decoders keep what they have.
        path: weights under the published keys, or under those of `transformers`.

    Raises:
        ToolkitError: the file cannot be read, or holds a Swin of another size or something else.
    """
    if network.config.fusion == "none":
        begin_streams([network.backbone], path)
    else:
        begin_streams([network.backbone_rgb_branch, network.backbone_xyz_branch], path)


def begin_streams(streams: Iterable[swin.Swin], path: Path) -> None:
    """Begin Swin transformers with the weights of one that was trained on ImageNet.

    Args:
        streams: their norms of the levels keep what they have.
        path: weights under the published keys, or under those of `transformers`.

    Raises:
        ToolkitError: the file cannot be read, or holds a Swin of another size or something else.
    """
    state = published_keys(read_weights(path))
    for stream in streams:
        own = {k: v for k, v in stream.state_dict().items() if not _kept(k)}
        check_keys(own, _for_channels(state, stream), path)
        stream.load_state_dict(_for_channels(state, stream), strict=False)


def published_keys(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The backbone's weights, under the published keys."""
    if any(".attention.self." in key for key in state):
        renamed = {}
        for key, tensor in state.items():
            for pattern, replacement in _RENAMED:
                key = re.sub(pattern, replacement, key)
            renamed[key] = tensor
        state = renamed
        for key in [key for key in state if ".attn.query." in key]:
            names = [key.replace(".query.", f".{part}.") for part in ("query", "key", "value")]
            parts = [state.pop(name) for name in names if name in state]
            state[key.replace(".query.", ".qkv.")] = torch.cat(parts)
    return {key: tensor for key, tensor in state.items() if not _UNUSED.match(key)}


def _kept(key: str) -> bool:
    return bool(re.match(r"norm\d\.", key)) or key.endswith("relative_position_index")


def _for_channels(state: dict[str, Tensor], stream: swin.Swin) -> dict[str, Tensor]:
    """Weights for images of three channels as weights for those of the stream.

    A fourth channel begins with the mean of the three.
    """
    name = "patch_embed.proj.weight"
    weight = state.get(name)
    if weight is None or weight.shape[1] != 3 or stream.patch_embed.proj.in_channels != 4:
        return state
    return state | {name: torch.cat([weight, weight.mean(dim=1, keepdim=True)], dim=1)}
