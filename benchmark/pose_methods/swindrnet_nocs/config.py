"""Sizes of SwinDRNet's pose network, and which of its forms to build."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from benchmark.methods.sizes import COMPACT_SIZE
from benchmark.pose_methods.fitting import FitSettings

# Numbers of the segmentation: 0 other, 1 to 7 the classes of DREDS, 8 background.
CLASSES = 9
BACKGROUND_CLASS = 8


@dataclass(frozen=True, kw_only=True)
class SwinNOCSConfig(FitSettings):
    """SwinDRNet + NOCSHead; the defaults are the published network's sizes.

    Attributes:
        fusion: how colour and points meet. `released` is what the published program computes:
            blocks of which every second one attends, from points to colour alone. `paper` is the
            formula of the paper's restoration network, attention both ways.
        channels: of the first of four levels; each next one has twice as many.
        depths, heads: blocks and attention heads of each level, of the streams and of the
            `released` fusion.
        window: side of the windows that are attended within, in tokens.
        head_channels: of the two decoders.
        pool_scales: sides of the decoders' pooled pyramids.
        fusion_heads, fusion_window: of the `paper` fusion, as in `SwinDRNetConfig`.
        details: whether the streams are shown what compact SwinDRNet's are, depth in the place of
            points, and details are kept: `relative` and `details` of `SwinDRNetConfig`.
        drop_path, dropout: chances in training to leave a block, and a channel, out.
        input_size: (width, height) of the images.
        instances: what counts as an object: all pixels of a `class`, as published, or each
            connected `piece` of them.
        least_pixels: pixels of an object at least, at the network's size.
        fit, threshold_m: of poses, see `FitSettings`.
    """

    fusion: Literal["released", "paper"] = "released"
    channels: int = 96
    depths: tuple[int, int, int, int] = (2, 2, 6, 2)
    heads: tuple[int, int, int, int] = (3, 6, 12, 24)
    window: int = 7
    head_channels: int = 512
    pool_scales: tuple[int, ...] = (1, 2, 3, 6)
    fusion_heads: int = 1
    fusion_window: int | None = None
    details: bool = False
    drop_path: float = 0.2
    dropout: float = 0.1
    input_size: tuple[int, int] = (224, 224)
    instances: Literal["class", "piece"] = "class"
    least_pixels: int = 10

    @property
    def level_channels(self) -> tuple[int, ...]:
        """Channels of the four levels of one stream."""
        return tuple(self.channels << level for level in range(4))

    @property
    def fused_channels(self) -> tuple[int, ...]:
        """Channels of the four levels that the decoders get."""
        copies = {"released": 1, "paper": 4}[self.fusion]
        return tuple(copies * channels for channels in self.level_channels)


PRESETS = {
    "published": SwinNOCSConfig(),
    "compact": SwinNOCSConfig(
        fusion="paper",
        channels=32,
        heads=(1, 2, 4, 8),
        head_channels=96,
        details=True,
        drop_path=0.1,
        input_size=COMPACT_SIZE,
    ),
}
