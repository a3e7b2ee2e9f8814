"""SwinDRNet's pose network (Dai et al., ECCV 2022): colour and points to classes and NOCS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from benchmark.methods.relative import told_color, told_depth
from benchmark.methods.swindrnet.details import DetailDecoder
from benchmark.methods.swindrnet.fusion import PaperFusion
from benchmark.methods.swindrnet.head import enlarged
from benchmark.methods.swindrnet.streams import SwinStreams
from benchmark.methods.swindrnet.swin import Swin
from benchmark.pose_methods.swindrnet_nocs.config import BACKGROUND_CLASS, CLASSES, SwinNOCSConfig
from benchmark.pose_methods.swindrnet_nocs.fusion import AttendingFusion

# The streams' names and the channels of the images that they get: x y z, or depth and whether
# there is any.
_POINT_IMAGES = {"backbone_rgb_branch": 3, "backbone_xyz_branch": 3}
_DEPTH_IMAGES = {"backbone_rgb_branch": 3, "backbone_xyz_branch": 2}
# What the first answers are about: background, as most pixels are, and the cube's middle. Weights
# as small as those of restored depth, which begins as the sensor's, would keep them there for long.
_BACKGROUND_FIRST, _MIDDLE = 3.0, 0.5
_SPREAD = 0.25


class SwinNOCSPrediction(NamedTuple):
    """What the network answers.

    Attributes:
        classes: (b, 9, h, w) logits: 0 other, 1 to 7 the classes, 8 background.
        nocs: (b, 3, h, w) normalised coordinates x y z, in [0, 1] on objects; not limited.
    """

    classes: Tensor
    nocs: Tensor


class SwinNOCSNetwork(SwinStreams):
    """`network(color, points)` to `SwinNOCSPrediction`.

    Colour is RGB in [0, 1], not normalised further; points are those of the sensor's depth in the
    camera frame, metres, 0 where it measured nothing.
    """

    config: SwinNOCSConfig
    backbone_rgb_branch: Swin
    backbone_xyz_branch: Swin

    def __init__(self, config: SwinNOCSConfig | None = None) -> None:
        config = config or SwinNOCSConfig()
        images = _DEPTH_IMAGES if config.details else _POINT_IMAGES
        super().__init__(config, images)
        self.decode_head_classes = self.head(CLASSES)
        self.decode_head_nocs = self.head(3)
        if config.details:
            self.details_of_classes = DetailDecoder(config.head_channels, len(images), CLASSES)
            self.details_of_nocs = DetailDecoder(config.head_channels, len(images), 3)
            _begin(self.details_of_classes.last, {BACKGROUND_CLASS: _BACKGROUND_FIRST})
            _begin(self.details_of_nocs.last, dict.fromkeys(range(3), _MIDDLE))
        self.add_fusion(self._fusion)

    def forward(self, color: Tensor, points: Tensor) -> SwinNOCSPrediction:
        """(b, 3, h, w) and (b, 3, h, w)."""
        levels, details = self.features_of(self._images(color, points))
        classes, nocs = self.decode_head_classes(levels), self.decode_head_nocs(levels)
        if self.config.details:
            classes = self.details_of_classes(classes, details)
            nocs = self.details_of_nocs(nocs, details)
        return SwinNOCSPrediction(enlarged(classes, color), enlarged(nocs, color))

    def _images(self, color: Tensor, points: Tensor) -> list[Tensor]:
        """What each stream is shown."""
        if not self.config.details:
            return [color, points]
        depth = points[:, 2:]
        return [told_color(color), torch.cat([told_depth(depth), depth > 0], dim=1)]

    def _fusion(self, level: int, channels: int) -> nn.Module:
        config = self.config
        if config.fusion == "paper":
            return PaperFusion(channels, config.fusion_heads, config.fusion_window)
        return AttendingFusion(channels, config.depths[level], config.heads[level], config.window)


def _begin(last: nn.Conv2d, answers: Mapping[int, float]) -> None:
    """Begin a layer with answers of some of its channels."""
    nn.init.normal_(last.weight, std=_SPREAD)
    assert last.bias is not None
    with torch.no_grad():
        for channel, answer in answers.items():
            last.bias[channel] = answer
