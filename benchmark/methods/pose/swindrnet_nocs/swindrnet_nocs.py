"""SwinDRNet's pose network as an estimator, and its weights.

Reads this project's weights and the authors'. The authors' network has two more decoders, for depth
and its confidence, which are not used; its NOCS decoder predicts 1 - z instead of z, as in the
images of the data set.
"""

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from benchmark.methods import weights
from benchmark.methods.pose.pose_network import Found, NetworkEstimator
from benchmark.methods.pose.swindrnet_nocs import swindrnet_nocs_network
from benchmark.methods.pose.swindrnet_nocs.instances import segments_of
from benchmark.methods.pose.swindrnet_nocs.trunk_network import TrunkNOCSNetwork
from benchmark.methods.registry import MethodOptions, preset_of
from benchmark.methods.torch_camera import points_of
from std_toolkit.plugins import configured

_LAST = ".conv_seg.weight"

# Decoders are known by how many maps they make: their names in the authors' program are not.
_OWN_NAMES = {swindrnet_nocs_network.CLASSES: "decode_head_classes", 3: "decode_head_nocs"}

# Parts that SwinDRNet has, too.
_SHARED = ("backbone_rgb_branch", "backbone_xyz_branch", "cross_attention_")


class SwinDRNetNOCS(NetworkEstimator):
    """Classes and coordinates of pixels from two Swin transformers; settings are those of
    `SwinNOCSConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(
            preset_of(swindrnet_nocs_network.PRESETS, options.preset), options.settings
        )
        network = pose_network(self.config)
        self.flipped = load_pose_weights(network, weights.weights_for("swindrnet-nocs", options))
        super().__init__(network, options, self.config)

    def inputs(self, color: Tensor, depth: Tensor, K: Tensor) -> tuple[Tensor, ...]:
        return color, points_of(depth, K)

    def found(self, outputs: swindrnet_nocs_network.SwinNOCSPrediction) -> list[Found]:
        chances = outputs.classes.float().softmax(dim=1)
        nocs = outputs.nocs.float()
        if self.flipped:
            nocs[:, 2] = 1 - nocs[:, 2]
        coordinates = nocs.permute(0, 2, 3, 1).cpu().numpy()
        likely = chances.cpu().numpy()
        middles = [None] * len(likely)
        if outputs.middles is not None:
            middles = list(outputs.middles.float().cpu().numpy())
        return [
            Found(segments_of(each, self.config, to_middle), c)
            for each, to_middle, c in zip(likely, middles, coordinates, strict=True)
        ]


def pose_network(
    config: swindrnet_nocs_network.SwinNOCSConfig,
) -> swindrnet_nocs_network.SwinNOCSNetwork | TrunkNOCSNetwork:
    """The network of a configuration.

    Raises:
        ToolkitError: the weights of its trunk cannot be read.
    """
    if config.trunk == "own":
        return swindrnet_nocs_network.SwinNOCSNetwork(config)
    return TrunkNOCSNetwork(config)


def load_pose_weights(
    network: swindrnet_nocs_network.SwinNOCSNetwork | TrunkNOCSNetwork, path: Path
) -> bool:
    """Read the network's weights from a file.

    Returns:
        Whether they are the authors', so that the network answers 1 - z in the place of z.

    Raises:
        ToolkitError: the file cannot be read, or holds weights of another network, or of another
            trunk.
    """
    state = weights.read_weights(path)
    if isinstance(network, TrunkNOCSNetwork):
        network.check_trunk(state, path)
        weights.load_weights(network, path)
        return False
    own = f"decode_head_nocs{_LAST}" in state
    authors = not own and {len(t) for k, t in state.items() if k.endswith(_LAST)} >= {*_OWN_NAMES}
    if authors:
        state = own_names(state)
    weights.check_keys(network.state_dict(), state, path)
    wanted = {name: tensor.dtype for name, tensor in network.state_dict().items()}
    network.load_state_dict({n: t.to(wanted[n]) for n, t in state.items()}, assign=True)
    return authors


def begin_pose_network(
    network: swindrnet_nocs_network.SwinNOCSNetwork | TrunkNOCSNetwork, path: Path
) -> None:
    """Give a network, before it is trained, the weights of a file.

    Args:
        network: all of it begins with weights of its own kind; with those of SwinDRNet its
            streams and their fusion do, and its decoders keep what they have.
        path: weights of either.

    Raises:
        ToolkitError: the file cannot be read, or holds weights of another network or other sizes.
    """
    if isinstance(network, TrunkNOCSNetwork):
        load_pose_weights(network, path)
        return
    state = weights.read_weights(path)
    if weights.architecture_of(state) != weights.SWINDRNET:
        weights.load_weights(network, path)  # not the authors', whose z is turned
        return
    shared = {k: v for k, v in state.items() if k.startswith(_SHARED)}
    own = {k: v for k, v in network.state_dict().items() if k.startswith(_SHARED)}
    rest = {k: v for k, v in state.items() if k not in shared}
    weights.check_keys(own | rest, state, path)
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
