"""ImageNet weights of Swin as the beginning of SwinDRNet's two streams, for training."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import torch
from torch import Tensor

from benchmark.methods.swindrnet.network import SwinDRNetwork
from benchmark.methods.swindrnet.swin import Swin
from benchmark.methods.weights import check_keys, read_weights

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


def load_imagenet(network: SwinDRNetwork, path: Path) -> None:
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


def begin_streams(streams: Iterable[Swin], path: Path) -> None:
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


def _for_channels(state: dict[str, Tensor], stream: Swin) -> dict[str, Tensor]:
    """Weights for images of three channels as weights for those of the stream.

    A fourth channel begins with the mean of the three.
    """
    name = "patch_embed.proj.weight"
    weight = state.get(name)
    if weight is None or weight.shape[1] != 3 or stream.patch_embed.proj.in_channels != 4:
        return state
    return state | {name: torch.cat([weight, weight.mean(dim=1, keepdim=True)], dim=1)}
