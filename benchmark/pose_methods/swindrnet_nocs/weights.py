"""Weights of SwinDRNet's pose network: this project's, and those that the authors' program saves.

The authors' network has two decoders more, for depth and its confidence, which nothing uses, and
its NOCS decoder answers 1 - z in the place of z, as the pictures of the data set hold it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from benchmark.methods.weights import (
    SWINDRNET,
    architecture_of,
    check_keys,
    load_weights,
    read_weights,
)
from benchmark.pose_methods.swindrnet_nocs.config import CLASSES
from benchmark.pose_methods.swindrnet_nocs.network import SwinNOCSNetwork

_LAST = ".conv_seg.weight"
# Decoders are known by how many maps they make: their names in the authors' program are not.
_OWN_NAMES = {CLASSES: "decode_head_classes", 3: "decode_head_nocs"}

# Parts that SwinDRNet has, too.
_SHARED = ("backbone_rgb_branch", "backbone_xyz_branch", "cross_attention_")


def load_pose_weights(network: SwinNOCSNetwork, path: Path) -> bool:
    """Read the network's weights from a file.

    Returns:
        Whether they are the authors', so that the network answers 1 - z in the place of z.

    Raises:
        ToolkitError: the file cannot be read, or holds weights of another network.
    """
    state = read_weights(path)
    own = f"decode_head_nocs{_LAST}" in state
    authors = not own and {len(t) for k, t in state.items() if k.endswith(_LAST)} >= {*_OWN_NAMES}
    if authors:
        state = own_names(state)
    check_keys(network.state_dict(), state, path)
    wanted = {name: tensor.dtype for name, tensor in network.state_dict().items()}
    network.load_state_dict({n: t.to(wanted[n]) for n, t in state.items()}, assign=True)
    return authors


def begin_pose_network(network: SwinNOCSNetwork, path: Path) -> None:
    """Give a network, before it is trained, the weights of a file.

    Args:
        network: all of it begins with weights of its own kind; with those of SwinDRNet its
            streams and their fusion do, and its decoders keep what they have.
        path: weights of either.

    Raises:
        ToolkitError: the file cannot be read, or holds weights of another network or other sizes.
    """
    state = read_weights(path)
    if architecture_of(state) != SWINDRNET:
        load_weights(network, path)  # not the authors', whose z is turned
        return
    shared = {k: v for k, v in state.items() if k.startswith(_SHARED)}
    own = {k: v for k, v in network.state_dict().items() if k.startswith(_SHARED)}
    rest = {k: v for k, v in state.items() if k not in shared}
    check_keys(own | rest, state, path)
    network.load_state_dict(shared, strict=False)


def own_names(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The authors' weights under this project's names, without the decoders that nothing uses."""
    heads = {
        key.removesuffix(_LAST): _OWN_NAMES.get(len(tensor))
        for key, tensor in state.items()
        if key.endswith(_LAST)
    }
    renamed = {}
    for key, tensor in state.items():
        if key.endswith("attn_mask"):
            continue  # follows from the size of the image
        head = next((h for h in heads if key.startswith(f"{h}.")), None)
        if head is None:
            renamed[key] = tensor
        elif (name := heads[head]) is not None:
            renamed[name + key.removeprefix(head)] = tensor
    return renamed
