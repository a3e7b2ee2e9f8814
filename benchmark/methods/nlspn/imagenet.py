"""ImageNet weights of ResNet-34 as the beginning of NLSPN's encoder, for training."""

from __future__ import annotations

from pathlib import Path

from benchmark.methods.nlspn.network import NLSPNetwork
from benchmark.methods.weights import check_keys, read_weights

_LEVELS = {"layer1": "conv2", "layer2": "conv3", "layer3": "conv4", "layer4": "conv5"}


def load_imagenet(network: NLSPNetwork, path: Path) -> None:
    """Begin the encoder's four levels with those of a ResNet-34 that was trained on ImageNet.

    Raises:
        ToolkitError: the file cannot be read, or holds another network.
    """
    state = {k: v for k, v in read_weights(path).items() if k.partition(".")[0] in _LEVELS}
    layers = {old: network.get_submodule(new) for old, new in _LEVELS.items()}
    wanted = {
        f"{old}.{key}": tensor
        for old, layer in layers.items()
        for key, tensor in layer.state_dict().items()
    }
    # Counts of batches are missing in older files and mean nothing here.
    wanted = {key: t for key, t in wanted.items() if not key.endswith("num_batches_tracked")}
    state = {key: t for key, t in state.items() if not key.endswith("num_batches_tracked")}
    check_keys(wanted, state, path)
    for old, layer in layers.items():
        own = {k.removeprefix(f"{old}."): t for k, t in state.items() if k.startswith(f"{old}.")}
        layer.load_state_dict(own, strict=False)
