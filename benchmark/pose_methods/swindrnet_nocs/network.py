"""SwinDRNet's pose network (Dai et al., ECCV 2022): colour and points to classes and NOCS."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor, nn

from benchmark.methods.swindrnet.fusion import PaperFusion
from benchmark.methods.swindrnet.head import UPerHead, enlarged
from benchmark.methods.swindrnet.swin import Swin
from benchmark.pose_methods.swindrnet_nocs.config import CLASSES, SwinNOCSConfig
from benchmark.pose_methods.swindrnet_nocs.fusion import AttendingFusion


class SwinNOCSPrediction(NamedTuple):
    """What the network answers.

    Attributes:
        classes: (b, 9, h, w) logits: 0 other, 1 to 7 the classes, 8 background.
        nocs: (b, 3, h, w) normalised coordinates x y z, in [0, 1] on objects; not limited.
    """

    classes: Tensor
    nocs: Tensor


class SwinNOCSNetwork(nn.Module):
    """`network(color, points)` to `SwinNOCSPrediction`.

    Colour is RGB in [0, 1], not normalised further; points are those of the sensor's depth in the
    camera frame, metres, 0 where it measured nothing.
    """

    def __init__(self, config: SwinNOCSConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or SwinNOCSConfig()
        self.backbone_rgb_branch = self._stream()
        self.backbone_xyz_branch = self._stream()
        self.decode_head_classes = self._head(CLASSES)
        self.decode_head_nocs = self._head(3)
        for level, channels in enumerate(config.level_channels):
            fusion: nn.Module
            if config.fusion == "released":
                fusion = AttendingFusion(
                    channels, config.depths[level], config.heads[level], config.window
                )
            else:
                fusion = PaperFusion(channels, config.fusion_heads, config.fusion_window)
            self.add_module(f"cross_attention_{level}", fusion)

    def forward(self, color: Tensor, points: Tensor) -> SwinNOCSPrediction:
        """(b, 3, h, w) and (b, 3, h, w)."""
        pairs = zip(self.backbone_rgb_branch(color), self.backbone_xyz_branch(points), strict=True)
        levels = [
            self.get_submodule(f"cross_attention_{level}")(*pair).permute(0, 3, 1, 2)
            for level, pair in enumerate(pairs)
        ]
        return SwinNOCSPrediction(
            enlarged(self.decode_head_classes(levels), color),
            enlarged(self.decode_head_nocs(levels), color),
        )

    def _stream(self) -> Swin:
        config = self.config
        return Swin(
            config.channels, config.depths, config.heads, config.window, 3, config.drop_path
        )

    def _head(self, outputs: int) -> UPerHead:
        config = self.config
        return UPerHead(
            config.fused_channels,
            config.head_channels,
            outputs,
            config.pool_scales,
            config.dropout,
        )
