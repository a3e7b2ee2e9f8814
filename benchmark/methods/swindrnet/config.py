"""Sizes of SwinDRNet, and which of its forms to build."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from benchmark.methods.sizes import COMPACT_SIZE


@dataclass(frozen=True, kw_only=True)
class SwinDRNetConfig:
    """SwinDRNet; the defaults are the network whose weights were published.

    Attributes:
        fusion: how colour and depth meet. `released` is what the published program computes, a
            perceptron per pixel: its attention has no effect. `paper` is the paper's formula,
            attention from colour to depth and from depth to colour. `none` is the ablation
            without fusion: one stream over colour and depth together.
        confidence: whether the sensor's depth is blended in by a confidence map.
        channels: of the first of four levels; each next one has twice as many.
        depths, heads: blocks and attention heads of each level.
        window: side of the windows that the Swin transformers attend within, in tokens.
        head_channels: of the two decoders.
        pool_scales: sides of the decoders' pooled pyramids.
        fusion_heads: attention heads of the `paper` fusion.
        fusion_window: side of the windows that the `paper` fusion attends within. None is the
            paper's formula: every token attends to the whole image.
        relative: whether the network is told depth, and tells it, relative to what the sensor
            measured (`benchmark.methods.relative`), and trusts no pixel that the sensor did not
            measure. The published network works in metres, and has to learn the latter.
        details: whether convolutions lead from the pixels to tokens of 8x8 pixels, and from the
            decoders' answers back to every pixel (`benchmark.methods.swindrnet.details`). As
            published, tokens are linear maps of 4x4 pixels and a map of a quarter of the
            resolution is enlarged: true depth, shrunk and enlarged so, has an error of 14 mm on
            objects at 224x224.
        drop_path, dropout: chances in training to leave a block, and a channel, out.
        input_size: (width, height) of the images.
    """

    fusion: Literal["released", "paper", "none"] = "released"
    confidence: bool = True
    channels: int = 96
    depths: tuple[int, int, int, int] = (2, 2, 6, 2)
    heads: tuple[int, int, int, int] = (3, 6, 12, 24)
    window: int = 7
    head_channels: int = 512
    pool_scales: tuple[int, ...] = (1, 2, 3, 6)
    fusion_heads: int = 1
    fusion_window: int | None = None
    relative: bool = False
    details: bool = False
    drop_path: float = 0.2
    dropout: float = 0.1
    input_size: tuple[int, int] = (224, 224)

    @property
    def level_channels(self) -> tuple[int, ...]:
        """Channels of the four levels of one stream."""
        return tuple(self.channels << level for level in range(4))

    @property
    def fused_channels(self) -> tuple[int, ...]:
        """Channels of the four levels that the decoders get."""
        copies = {"released": 3, "paper": 4, "none": 1}[self.fusion]
        return tuple(copies * channels for channels in self.level_channels)


PRESETS = {
    "published": SwinDRNetConfig(),
    "compact": SwinDRNetConfig(
        fusion="paper",
        channels=32,
        heads=(1, 2, 4, 8),
        head_channels=96,
        relative=True,
        details=True,
        drop_path=0.1,
        input_size=COMPACT_SIZE,
    ),
}
