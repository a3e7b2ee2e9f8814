"""SwinDRNet (Dai et al., ECCV 2022) from colour and sensor depth to restored depth."""

from __future__ import annotations

import torch
from torch import Tensor

from benchmark.methods.network import Prediction
from benchmark.methods.relative import coarse_depth, in_metres, told_color, told_depth
from benchmark.methods.swindrnet.config import SwinDRNetConfig
from benchmark.methods.swindrnet.details import DetailDecoder
from benchmark.methods.swindrnet.fusion import PaperFusion, ReleasedFusion
from benchmark.methods.swindrnet.head import enlarged
from benchmark.methods.swindrnet.streams import Features, SwinStreams
from benchmark.methods.swindrnet.swin import Swin

_DEPTH_COPIES = 3  # depth goes into a network of three channels, which ImageNet weights fit


class SwinDRNetwork(SwinStreams):
    """`network(color, depth)` to `Prediction`: depth, initial depth, confidence of the sensor.

    Colour is RGB in [0, 1], not normalised further, and depth is in metres, as in the published
    program. Nothing is clamped: a predicted depth may be negative.
    """

    config: SwinDRNetConfig
    backbone: Swin
    backbone_rgb_branch: Swin
    backbone_xyz_branch: Swin

    def __init__(self, config: SwinDRNetConfig | None = None) -> None:
        config = config or SwinDRNetConfig()
        images = _images_of(config)
        super().__init__(config, images)
        self.decode_head_depth_restoration = self.head(1)
        if config.confidence:
            self.decode_head_confidence = self.head(2)
        if config.details:
            self.details_of_depth = DetailDecoder(config.head_channels, len(images), 1)
            if config.confidence:
                self.details_of_confidence = DetailDecoder(config.head_channels, len(images), 2)
        if config.fusion == "released":
            self.add_fusion(lambda _, channels: ReleasedFusion(channels, config.window))
        elif config.fusion == "paper":
            self.add_fusion(
                lambda _, channels: PaperFusion(channels, config.fusion_heads, config.fusion_window)
            )

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
        """
        found = self.features(color, depth)
        confidence = self.decode_head_confidence(found.levels) if self.config.confidence else None
        initial = self.decode_head_depth_restoration(found.levels)
        return self.answer(depth, found.details, initial, confidence)

    def features(self, color: Tensor, depth: Tensor) -> Features:
        """What the decoders get; of colour and depth as `forward` does."""
        return self.features_of(self._images(color, depth))

    def _images(self, color: Tensor, depth: Tensor) -> list[Tensor]:
        """What each stream is shown."""
        config = self.config
        measured = (depth > 0).to(depth.dtype)
        if config.relative:
            color, depth = told_color(color), told_depth(depth)
        if config.details:
            depth = torch.cat([depth, measured], dim=1)
        if config.fusion == "none":
            return [torch.cat([color, depth], dim=1)]
        if config.details:
            return [color, depth]
        return [color, depth.expand(-1, _DEPTH_COPIES, -1, -1)]

    def answer(
        self, depth: Tensor, details: list[Tensor], initial: Tensor, confidence: Tensor | None
    ) -> Prediction:
        """What the decoders' maps say; that of confidence is None without such a decoder."""
        config = self.config
        if config.details:
            initial = self.details_of_depth(initial, details)
        initial = enlarged(initial, depth)
        if config.relative:
            initial = in_metres(coarse_depth(depth), initial)
        if confidence is None:
            return Prediction(initial, initial)
        if config.details:
            confidence = self.details_of_confidence(confidence, details)
        confidence = enlarged(confidence, depth)
        if config.relative:
            nothing = torch.cat([depth == 0, torch.zeros_like(depth, dtype=torch.bool)], dim=1)
            confidence = confidence.masked_fill(nothing, -torch.inf)
        return blended(depth, initial, confidence)


def blended(depth: Tensor, initial: Tensor, logits: Tensor) -> Prediction:
    """The sensor's depth and the predicted one, by a softmax over their two logits (b, 2, h, w)."""
    of_sensor, of_initial = logits.softmax(dim=1).split(1, dim=1)
    return Prediction(of_sensor * depth + of_initial * initial, initial, of_sensor)


def _images_of(config: SwinDRNetConfig) -> dict[str, int]:
    """The streams' names, and the channels of the images that they get.

    Where details are kept, depth comes with whether it was measured.
    """
    if config.fusion == "none":
        return {"backbone": 5 if config.details else 4}
    of_depth = 2 if config.details else _DEPTH_COPIES
    return {"backbone_rgb_branch": 3, "backbone_xyz_branch": of_depth}
