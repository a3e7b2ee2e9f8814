"""NOCS as a pose estimator."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import load_weights, weights_for
from benchmark.pose_methods.network import Found, NetworkEstimator
from benchmark.pose_methods.nocs.config import PRESETS
from benchmark.pose_methods.nocs.network import NOCSNetwork, NOCSPrediction, coordinates_of
from benchmark.pose_methods.nocs.regions import put_back
from benchmark.pose_methods.segmented import Segmented


class NOCS(NetworkEstimator):
    """Instances and binned coordinates of colour alone; settings are those of `NOCSConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(preset_of(PRESETS, options.preset), options.settings)
        network = NOCSNetwork(self.config)
        load_weights(network, weights_for("nocs", options))
        super().__init__(network, options, self.config)

    def inputs(self, color: Tensor, depth: Tensor, K: Tensor) -> tuple[Tensor, ...]:  # noqa: ARG002
        return (color,)

    def found(self, outputs: NOCSPrediction) -> list[Found]:
        return [
            objects_of(outputs, image, self.config.decode, self.size)
            for image in range(len(outputs.boxes.classes))
        ]


def objects_of(outputs: NOCSPrediction, image: int, decode: str, size: tuple[int, int]) -> Found:
    """The objects of an image of the batch, best first.

    Args:
        size: (width, height) of the image.
    """
    regions = outputs.regions
    mine = (regions.image == image).nonzero()[:, 0]
    boxes, class_ids, scores = regions.boxes[mine], regions.class_ids[mine], regions.scores[mine]
    masks = put_back(outputs.masks[mine, None].sigmoid(), boxes, size, "bilinear")[:, 0] > 0.5
    inside = coordinates_of(outputs.bins[mine], decode)
    # By the nearest cell: what lies outside of an object's mask was never learnt.
    coordinates = put_back(inside, boxes, size, "nearest").permute(0, 2, 3, 1)
    there = masks.flatten(1).any(dim=1)
    segmented = Segmented(
        class_ids[there].cpu().numpy().astype(np.int64),
        scores[there].double().cpu().numpy(),
        masks[there].cpu().numpy(),
    )
    return Found(segmented, coordinates[there].float().cpu().numpy())
