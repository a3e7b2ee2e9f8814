"""Sizes of the NOCS network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from benchmark.pose_methods.fitting import FitSettings

CLASSES = 7  # 1 bottle to 7 aeroplane; what is of no class is not looked for


@dataclass(frozen=True, kw_only=True)
class NOCSConfig(FitSettings):
    """NOCS; the defaults are the published sizes, where there are any.

    Attributes:
        block: `bottleneck` for a ResNet-50, as published, `basic` for the smaller blocks.
        channels: of the first level of the backbone (its inner ones for `bottleneck`).
        blocks: of its four levels.
        pyramid: channels of the feature pyramid.
        tower: convolutions of the detector before its answers.
        region_channels, region_convs: of the mask and coordinate heads.
        bins: parts that each coordinate is told in.
        decode: what a bin stands for: its `centre`, or its lower `edge`, as in the published
            program, which puts all coordinates 1/64 too low.
        least_score: objects below are not answered. 0.7 in the published program, whose scores
            are another detector's.
        overlap: IoU of boxes of one class above which the worse one goes.
        most: objects of an image.
        input_size: (width, height) of the images.
        fit, threshold_m: of poses, see `FitSettings`.
    """

    block: Literal["bottleneck", "basic"] = "bottleneck"
    channels: int = 64
    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    pyramid: int = 256
    tower: int = 4
    region_channels: int = 256
    region_convs: int = 4
    bins: int = 32
    decode: Literal["centre", "edge"] = "centre"
    least_score: float = 0.3
    overlap: float = 0.5
    most: int = 30
    input_size: tuple[int, int] = (640, 360)

    @property
    def level_channels(self) -> tuple[int, ...]:
        """Channels of the backbone's four levels."""
        wider = 4 if self.block == "bottleneck" else 1
        return tuple(wider * self.channels << level for level in range(4))


PRESETS = {
    "published": NOCSConfig(),
    "compact": NOCSConfig(
        block="basic",
        blocks=(2, 2, 2, 2),
        pyramid=96,
        tower=2,
        region_channels=96,
        input_size=(224, 224),
    ),
}
