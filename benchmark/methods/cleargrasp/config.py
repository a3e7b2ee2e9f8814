"""Sizes of ClearGrasp's networks and of the image whose depth is optimised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class ClearGraspConfig:
    """ClearGrasp; the defaults are the published networks.

    Attributes:
        mask: which measurements are dropped. `predicted` asks the network for the pixels of
            transparent objects, as published; `given` those that the method is told, which are of
            transparent and specular objects.
        grow_px: by how many pixels of the optimised image the mask is widened.
        width: channels of the first layer of a backbone; the last ones have 32 times as many.
        bottleneck: whether its blocks have three convolutions (DRN-D-54) or two.
        blocks: of its eight levels.
        head_channels: of what follows the backbone.
        input_size: (width, height) of the images that the networks see.
        depth_size: (width, height) of the image whose depth is optimised.
    """

    mask: Literal["predicted", "given"] = "predicted"
    grow_px: int = 2
    width: int = 16
    bottleneck: bool = True
    blocks: tuple[int, int, int, int, int, int, int, int] = (1, 1, 3, 4, 6, 3, 1, 1)
    head_channels: int = 256
    input_size: tuple[int, int] = (256, 256)
    depth_size: tuple[int, int] = (256, 144)


PRESETS = {
    "published": ClearGraspConfig(),
    "compact": ClearGraspConfig(
        width=8, bottleneck=False, blocks=(1, 1, 2, 2, 2, 2, 1, 1), head_channels=64
    ),
}
