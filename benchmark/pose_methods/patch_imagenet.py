"""ImageNet weights of ResNet-18 as the beginning of networks over patches, for training."""

from __future__ import annotations

from pathlib import Path

from benchmark.methods.weights import check_keys, read_weights
from benchmark.pose_methods.patch_features import PatchFeatures
from benchmark.pose_methods.spd.network import PriorNetwork

_PARTS = ("conv1", "bn1", "layer1", "layer2", "layer3", "layer4")
_COUNT = "num_batches_tracked"  # missing in older files, and without meaning here


def load_imagenet(network: PriorNetwork, path: Path) -> None:
    """Begin the ResNet over colour with one that was trained on ImageNet.

    Raises:
        ToolkitError: the file cannot be read, or holds another network.
    """
    color = network.get_submodule("color")
    assert isinstance(color, PatchFeatures)
    wanted = {
        key: tensor
        for key, tensor in color.state_dict().items()
        if key.partition(".")[0] in _PARTS and not key.endswith(_COUNT)
    }
    state = {
        key: tensor
        for key, tensor in read_weights(path).items()
        if key.partition(".")[0] in _PARTS and not key.endswith(_COUNT)
    }
    check_keys(wanted, state, path)
    color.load_state_dict(state, strict=False)
