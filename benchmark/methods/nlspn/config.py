"""Sizes of NLSPN."""

from __future__ import annotations

from dataclasses import dataclass

from benchmark.methods.sizes import COMPACT_SIZE


@dataclass(frozen=True, kw_only=True)
class NLSPNConfig:
    """NLSPN; the defaults are the published network.

    Attributes:
        channels: of the first level of the encoder; a multiple of 8.
        blocks: of its four levels; the published ones are those of ResNet-34.
        steps: of the propagation.
        preserve_input: keep the sensor's depth where there is some, at every step. It is for depth
            that is sparse and right; the depth of transparent objects is there and wrong.
        relative: whether the network is told depth, and tells it, relative to what the sensor
            measured (`benchmark.methods.relative`). The published network works in metres.
        input_size: (width, height) of the images. What the network was given on DREDS is not
            published; these are the images of that data set's own network.
    """

    channels: int = 64
    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    steps: int = 18
    preserve_input: bool = False
    relative: bool = False
    input_size: tuple[int, int] = (224, 224)


PRESETS = {
    "published": NLSPNConfig(),
    "compact": NLSPNConfig(
        channels=24, blocks=(1, 2, 2, 2), relative=True, input_size=COMPACT_SIZE
    ),
}
