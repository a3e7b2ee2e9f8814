"""SwinDRNet's pose network as an estimator, and its weights.

Reads this project's weights and the authors'. The authors' network has two more decoders, for depth
and its confidence, which are not used; its NOCS decoder predicts 1 - z instead of z, as in the
images of the data set.
"""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from benchmark.methods import weights
from benchmark.methods.pose.pose_network import Found, NetworkEstimator
from benchmark.methods.pose.segmented import Segmented
from benchmark.methods.pose.swindrnet_nocs import swindrnet_nocs_network
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import (
    BACKGROUND_CLASS,
    SwinNOCSConfig,
)
from benchmark.methods.pose.swindrnet_nocs.trunk_network import TrunkNOCSNetwork
from benchmark.methods.registry import MethodOptions, preset_of
from benchmark.methods.torch_camera import points_of
from std_toolkit.errors import ToolkitError
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

    settings_type = swindrnet_nocs_network.SwinNOCSConfig

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


_OTHER = 0  # objects of no class


def segments_of(
    chances: NDArray[np.float32],
    config: SwinNOCSConfig,
    middles: NDArray[np.float32] | None = None,
) -> Segmented:
    """The objects of an image, best first; a score is the mean chance of the object's pixels.

    Args:
        chances: (9, h, w) of each class at each pixel.
        config: what counts as an object.
        middles: (2, h, w) how far the middle of each pixel's object is away, x and y in pixels.

    Raises:
        ToolkitError: objects are told apart by middles, and there are none.
    """
    if config.instances == "middle":
        if middles is None:
            raise ToolkitError(
                "the network does not say where the middles of objects are",
                field="instances",
                value="middle",
                hint="choose class or piece, or --set trunk=swindrnet",
            )
        found = _by_middles(chances, middles, config)
    else:
        found = _by_classes(chances, config)
    return found.of(np.argsort(-found.scores, kind="stable"))


def _by_classes(chances: NDArray[np.float32], config: SwinNOCSConfig) -> Segmented:
    """What has one class is an object, or each piece of it."""
    best = chances.argmax(axis=0)
    classes: list[int] = []
    masks: list[NDArray[np.bool_]] = []
    for class_id in range(1, BACKGROUND_CLASS):
        pieces = _pieces(best == class_id, config.instances)
        some = [mask for mask in pieces if mask.sum() >= config.least_pixels]
        classes += [class_id] * len(some)
        masks += some
    scores = [float(chances[k][mask].mean()) for k, mask in zip(classes, masks, strict=True)]
    return Segmented(
        np.array(classes, np.int64),
        np.array(scores, np.float64),
        np.array(masks, bool).reshape(-1, *best.shape),
    )


def _pieces(mask: NDArray[np.bool_], instances: str) -> list[NDArray[np.bool_]]:
    if instances == "class" or not mask.any():
        return [mask] if mask.any() else []
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    return [labels == number for number in range(1, count)]


def _by_middles(
    chances: NDArray[np.float32], middles: NDArray[np.float32], config: SwinNOCSConfig
) -> Segmented:
    """What points to one middle is an object.

    Its pixels choose the class together: a few that look like another one do not split an object.
    """
    labels = grouped(chances.argmax(axis=0) != BACKGROUND_CLASS, middles, config.apart)
    masks = [labels == number for number in range(labels.max() + 1)]
    masks = [mask for mask in masks if mask.sum() >= config.least_pixels]
    means = np.array([chances[:BACKGROUND_CLASS, mask].mean(axis=1) for mask in masks], float)
    means = means.reshape(-1, BACKGROUND_CLASS)
    means /= means.sum(axis=1, keepdims=True).clip(1e-9)
    known = means[:, _OTHER + 1 :]
    found = Segmented(
        known.argmax(axis=1).astype(np.int64) + 1 if len(known) else np.zeros(0, np.int64),
        known.max(axis=1, initial=0.0),
        np.array(masks, bool).reshape(-1, *labels.shape),
        means,
    )
    return found.of(means[:, _OTHER] < config.other)


def grouped(
    there: NDArray[np.bool_], middles: NDArray[np.float32], apart: float
) -> NDArray[np.int64]:
    """Which object the pixels of objects belong to.

    Every pixel votes for the place it points to. Objects are the places with more votes around them
    than any other within `apart`; a pixel belongs to the one nearest to its vote.

    Args:
        there: (h, w) pixels of objects.
        middles: (2, h, w) x and y from a pixel to the middle of its object, pixels.
        apart: least distance of two middles, pixels.

    Returns:
        (h, w) numbers from 0; -1 where there is no object.
    """
    labels = np.full(there.shape, -1, np.int64)
    rows, columns = np.nonzero(there)
    if not len(rows):
        return labels
    h, w = there.shape
    x = np.clip(columns + middles[0, rows, columns], 0, w - 1)
    y = np.clip(rows + middles[1, rows, columns], 0, h - 1)
    votes = np.zeros((h, w), np.float32)
    np.add.at(votes, (np.rint(y).astype(int), np.rint(x).astype(int)), 1)
    votes = np.asarray(cv2.GaussianBlur(votes, (0, 0), apart / 3), np.float32)
    side = 2 * round(apart) + 1
    around = cv2.dilate(votes, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    peaks = np.argwhere((votes == around) & (votes > 0))
    _, nearest = cKDTree(peaks).query(np.stack([y, x], axis=1))
    labels[rows, columns] = nearest
    return labels
