"""Sizes of DFNet, and which depths it believes."""

from __future__ import annotations

from dataclasses import dataclass

from benchmark.methods.sizes import COMPACT_SIZE


@dataclass(frozen=True, kw_only=True)
class DFNetConfig:
    """DFNet; the defaults are the published network.

    Attributes:
        channels: between the blocks.
        layers, growth: of a dense block: how many layers, and the channels that each adds.
        near, far: metres; what the sensor measured outside counts as not measured.
        outlier: what lies farther than so many standard deviations from the mean of the image's
            depths counts as not measured.
        relative: whether the network is told depth, and tells it, relative to what the sensor
            measured (`benchmark.methods.relative`). The published network works in metres.
        input_size: (width, height) of the images.
    """

    channels: int = 64
    layers: int = 5
    growth: int = 12
    near: float = 0.3
    far: float = 1.5
    outlier: float = 10.0
    relative: bool = False
    input_size: tuple[int, int] = (320, 240)


PRESETS = {
    "published": DFNetConfig(),
    "compact": DFNetConfig(channels=32, layers=4, relative=True, input_size=COMPACT_SIZE),
}
