"""SwinDRNet's pose network as a pose estimator."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import weights_for
from benchmark.pose_methods.network import Found, NetworkEstimator, points_of
from benchmark.pose_methods.segmented import Segmented
from benchmark.pose_methods.swindrnet_nocs.config import BACKGROUND_CLASS, PRESETS, SwinNOCSConfig
from benchmark.pose_methods.swindrnet_nocs.network import SwinNOCSNetwork, SwinNOCSPrediction
from benchmark.pose_methods.swindrnet_nocs.weights import load_pose_weights


class SwinDRNetNOCS(NetworkEstimator):
    """Classes and coordinates of pixels from two Swin transformers; settings are those of
    `SwinNOCSConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(preset_of(PRESETS, options.preset), options.settings)
        network = SwinNOCSNetwork(self.config)
        self.flipped = load_pose_weights(network, weights_for("swindrnet-nocs", options))
        super().__init__(network, options, self.config)

    def inputs(self, color: Tensor, depth: Tensor, K: Tensor) -> tuple[Tensor, ...]:
        return color, points_of(depth, K)

    def found(self, outputs: SwinNOCSPrediction) -> list[Found]:
        chances = outputs.classes.float().softmax(dim=1)
        nocs = outputs.nocs.float()
        if self.flipped:
            nocs[:, 2] = 1 - nocs[:, 2]
        coordinates = nocs.permute(0, 2, 3, 1).cpu().numpy()
        return [
            Found(segments_of(likely, self.config), c)
            for likely, c in zip(chances.cpu().numpy(), coordinates, strict=True)
        ]


def segments_of(chances: NDArray[np.float32], config: SwinNOCSConfig) -> Segmented:
    """The objects of an image, best first; a score is the mean chance of the object's pixels.

    Args:
        chances: (9, h, w) of each class at each pixel.
        config: what counts as an object.
    """
    best = chances.argmax(axis=0)
    classes: list[int] = []
    scores: list[float] = []
    masks: list[NDArray[np.bool_]] = []
    for class_id in range(1, BACKGROUND_CLASS):
        for mask in _objects(best == class_id, config.instances):
            if mask.sum() >= config.least_pixels:
                classes.append(class_id)
                scores.append(float(chances[class_id][mask].mean()))
                masks.append(mask)
    order = np.argsort([-score for score in scores], kind="stable").astype(int)
    h, w = best.shape
    return Segmented(
        np.array(classes, np.int64)[order],
        np.array(scores, np.float64)[order],
        np.array(masks, bool).reshape(-1, h, w)[order],
    )


def _objects(mask: NDArray[np.bool_], instances: str) -> list[NDArray[np.bool_]]:
    if instances == "class" or not mask.any():
        return [mask] if mask.any() else []
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    return [labels == number for number in range(1, count)]
