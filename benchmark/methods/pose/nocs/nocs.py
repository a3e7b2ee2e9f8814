"""NOCS (Wang et al., CVPR 2019): network and pose estimator.

Mask and coordinate heads are as published; the detector is not (see `detector`).
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.methods.network import network_of, padded_to
from benchmark.methods.pose.nocs import detector
from benchmark.methods.pose.nocs.nocs_backbone import CLASSES, PRESETS, STRIDES, NOCSConfig, Pyramid
from benchmark.methods.pose.pose_network import Found, NetworkEstimator
from benchmark.methods.pose.segmented import Segmented
from benchmark.methods.registry import MethodOptions

SIDE = 28  # of the masks and coordinates of a region


class NOCSPrediction(NamedTuple):
    """What the network answers.

    Attributes:
        boxes: what the detector says.
        regions: those that masks and coordinates are of: given, or found.
        masks: (n, 28, 28) logits, of the class of each region.
        bins: (n, 3, bins, 28, 28) logits of x, y and z.
    """

    boxes: detector.Boxes
    regions: detector.Regions
    masks: Tensor
    bins: Tensor


class NOCSNetwork(nn.Module):
    """`network(color, regions)` to `NOCSPrediction`; without regions, those that it finds."""

    def __init__(self, config: NOCSConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or NOCSConfig()
        self.pyramid = Pyramid(config)
        self.detector = detector.Detector(config)
        self.mask_head = RegionHead(config, CLASSES)
        self.coordinate_heads = nn.ModuleList(
            RegionHead(config, CLASSES * config.bins) for _ in range(3)
        )

    def forward(self, color: Tensor, regions: detector.Regions | None = None) -> NOCSPrediction:
        """(b, 3, h, w) RGB in [0, 1]."""
        h, w = color.shape[-2:]
        levels = self.pyramid(padded_to(color, STRIDES[-1]))
        boxes = self.detector(
            [levels[i] for i in detector.LEVELS], [STRIDES[i] for i in detector.LEVELS]
        )
        if regions is None:
            regions = detector.detections_of(boxes, self.config, (w, h))
        cut = detector.cut_out(levels, regions.boxes, regions.image, STRIDES, SIDE // 2)
        masks = of_class(self.mask_head(cut), regions.class_ids)[:, 0]
        bins = [of_class(head(cut), regions.class_ids) for head in self.coordinate_heads]
        return NOCSPrediction(boxes, regions, masks.float(), torch.stack(bins, dim=1).float())


class RegionHead(nn.Module):
    """Convolutions over a region of 14x14 cells to maps of 28x28."""

    def __init__(self, config: NOCSConfig, outputs: int) -> None:
        super().__init__()
        wide = config.region_channels
        layers: list[nn.Module] = []
        inputs = config.pyramid
        for _ in range(config.region_convs):
            layers += [
                nn.Conv2d(inputs, wide, 3, padding=1),
                # Of groups, not of the batch as published: it may hold one object, or none.
                nn.GroupNorm(detector.groups_of(wide), wide),
                nn.ReLU(),
            ]
            inputs = wide
        self.layers = nn.Sequential(
            *layers, nn.ConvTranspose2d(inputs, wide, 2, 2), nn.ReLU(), nn.Conv2d(wide, outputs, 1)
        )

    def forward(self, regions: Tensor) -> Tensor:
        return self.layers(regions)


def of_class(maps: Tensor, class_ids: Tensor) -> Tensor:
    """(n, c, h, w) of (n, 7 * c, h, w): the maps of each region's class."""
    n, c, h, w = maps.shape
    by_class = maps.reshape(n, CLASSES, c // CLASSES, h, w)
    return by_class[torch.arange(n, device=maps.device), class_ids - 1]


def coordinates_of(bins: Tensor, decode: str) -> Tensor:
    """(n, 3, h, w) coordinates in [0, 1] of the likeliest of (n, 3, bins, h, w) bins."""
    shift = 0.5 if decode == "centre" else 0.0
    return (bins.argmax(dim=2) + shift) / bins.shape[2]


class NOCS(NetworkEstimator):
    """Instances and binned coordinates of colour alone; settings are those of `NOCSConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = NOCSConfig

    def __init__(self, options: MethodOptions) -> None:
        self.config, network = network_of("nocs", PRESETS, NOCSNetwork, options)
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
    masks = (
        detector.put_back(outputs.masks[mine, None].sigmoid(), boxes, size, "bilinear")[:, 0] > 0.5
    )
    inside = coordinates_of(outputs.bins[mine], decode)
    # By the nearest cell: what lies outside of an object's mask was never learnt.
    coordinates = detector.put_back(inside, boxes, size, "nearest").permute(0, 2, 3, 1)
    there = masks.flatten(1).any(dim=1)
    segmented = Segmented(
        class_ids[there].cpu().numpy().astype(np.int64),
        scores[there].double().cpu().numpy(),
        masks[there].cpu().numpy(),
    )
    return Found(segmented, coordinates[there].float().cpu().numpy())
