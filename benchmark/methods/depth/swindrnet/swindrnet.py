"""SwinDRNet as a restorer: fast inference, and ImageNet weights for training.

Inference uses an equivalent network that is faster on a CPU, see `fast.py`.
"""

import re
from collections.abc import Iterable
from pathlib import Path

import torch
from torch import Tensor, nn

from benchmark.methods.depth.swindrnet import swin, swindrnet_network
from benchmark.methods.depth.swindrnet.fast import FastSwinDRNetwork
from benchmark.methods.network import NetworkRestorer, Prediction, network_of, torch_device
from benchmark.methods.registry import MethodOptions
from benchmark.methods.weights import check_keys, is_untrained, read_weights
from std_toolkit.errors import ToolkitError

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

    settings_type = swindrnet_network.SwinDRNetConfig

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
    if options.weights is None and config.input_size != own and not is_untrained():
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
