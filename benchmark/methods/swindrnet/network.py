"""SwinDRNet (Dai et al., ECCV 2022) from colour and sensor depth to restored depth."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import pixel_shuffle

from benchmark.methods.network import Prediction
from benchmark.methods.relative import coarse_depth, in_metres, told_color, told_depth
from benchmark.methods.swindrnet.config import SwinDRNetConfig
from benchmark.methods.swindrnet.fusion import PaperFusion, ReleasedFusion
from benchmark.methods.swindrnet.head import UPerHead, enlarged
from benchmark.methods.swindrnet.swin import PATCH, Swin

_DEPTH_COPIES = 3  # depth goes into a network of three channels, which ImageNet weights fit


class SwinDRNetwork(nn.Module):
    """`network(color, depth)` to `Prediction`: depth, initial depth, confidence of the sensor.

    Colour is RGB in [0, 1], not normalised further, and depth is in metres, as in the published
    program. Nothing is clamped: a predicted depth may be negative.
    """

    def __init__(self, config: SwinDRNetConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or SwinDRNetConfig()
        if config.fusion == "none":
            self.backbone = self._stream(in_channels=4)
        else:
            self.backbone_rgb_branch = self._stream()
            self.backbone_xyz_branch = self._stream(in_channels=_DEPTH_COPIES)
        self.decode_head_depth_restoration = self._head(1)
        if config.confidence:
            self.decode_head_confidence = self._head(2)
        if config.fusion != "none":
            for level, channels in enumerate(config.level_channels):
                fusion: nn.Module = (
                    ReleasedFusion(channels, config.window)
                    if config.fusion == "released"
                    else PaperFusion(channels, config.fusion_heads, config.fusion_window)
                )
                self.add_module(f"cross_attention_{level}", fusion)

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
        """
        levels = self.levels(color, depth)
        confidence = self.decode_head_confidence(levels) if self.config.confidence else None
        return self.answer(depth, self.decode_head_depth_restoration(levels), confidence)

    def answer(self, depth: Tensor, initial: Tensor, confidence: Tensor | None) -> Prediction:
        """What the decoders' maps say; that of confidence is None without such a decoder."""
        initial = self._whole(initial, depth)
        if self.config.relative:
            initial = in_metres(coarse_depth(depth), initial)
        if confidence is None:
            return Prediction(initial, initial)
        return blended(depth, initial, self._whole(confidence, depth))

    def levels(self, color: Tensor, depth: Tensor) -> list[Tensor]:
        """The four levels of features (b, c, h, w) that the decoders get."""
        if self.config.relative:
            color, depth = told_color(color), told_depth(depth)
        if self.config.fusion == "none":
            levels = self.backbone(torch.cat([color, depth], dim=1))
        else:
            of_color = self.backbone_rgb_branch(color)
            of_depth = self.backbone_xyz_branch(depth.expand(-1, _DEPTH_COPIES, -1, -1))
            levels = [
                self.get_submodule(f"cross_attention_{level}")(*pair)
                for level, pair in enumerate(zip(of_color, of_depth, strict=True))
            ]
        return [level.permute(0, 3, 1, 2) for level in levels]

    def _whole(self, answer: Tensor, like: Tensor) -> Tensor:
        """A decoder's map at the resolution of the image."""
        if not self.config.sharp:
            return enlarged(answer, like)
        h, w = like.shape[-2:]
        return pixel_shuffle(answer, PATCH)[..., :h, :w]

    def _stream(self, in_channels: int = 3) -> Swin:
        config = self.config
        return Swin(
            config.channels,
            config.depths,
            config.heads,
            config.window,
            in_channels,
            config.drop_path,
        )

    def _head(self, outputs: int) -> UPerHead:
        config = self.config
        return UPerHead(
            config.fused_channels,
            config.head_channels,
            outputs * (PATCH**2 if config.sharp else 1),
            config.pool_scales,
            config.dropout,
        )


def blended(depth: Tensor, initial: Tensor, logits: Tensor) -> Prediction:
    """The sensor's depth and the predicted one, by a softmax over their two logits (b, 2, h, w)."""
    of_sensor, of_initial = logits.softmax(dim=1).split(1, dim=1)
    return Prediction(of_sensor * depth + of_initial * initial, initial, of_sensor)
