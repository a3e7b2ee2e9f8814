"""Sizes of SGPA."""

from __future__ import annotations

from dataclasses import dataclass, replace

from benchmark.pose_methods.spd.config import PriorNetworkConfig


@dataclass(frozen=True, kw_only=True)
class SGPAConfig(PriorNetworkConfig):
    """The network; see `PriorNetworkConfig`.

    Attributes:
        centres: points that are left at each level of PointNet++.
        radii: two at each level, smaller and larger in turn, in the unit of the points.
        prior_radii: the same for the prior, whose diagonal is 1.
        neighbours: of a centre at the smaller and at the larger radius.
        thickness: by what the channels of PointNet++ are divided.
        structure: how many points stand for an object's structure.
        structure_widths: of the network that chooses them.
        heads: of the attention.
    """

    centres: tuple[int, ...] = (512, 256, 128, 64)
    radii: tuple[float, ...] = (0.01, 0.02, 0.02, 0.04, 0.04, 0.08, 0.08, 0.16)
    prior_radii: tuple[float, ...] = (0.01, 0.02, 0.02, 0.04, 0.04, 0.08, 0.08, 0.16)
    neighbours: tuple[int, ...] = (16, 32)
    thickness: int = 1
    structure: int = 256
    structure_widths: tuple[int, ...] = (128, 256)
    heads: int = 4


_PUBLISHED = SGPAConfig()

PRESETS = {
    "published": _PUBLISHED,
    "compact": replace(
        _PUBLISHED,
        side=96,
        points=512,
        color_width=32,
        color_decoder=(64, 32, 32, 32),
        width=256,
        hidden=(256, 128),
        centred=True,
        # Of points that are a unit away from their middle on average.
        centres=(256, 128, 64, 32),
        radii=(0.1, 0.2, 0.2, 0.4, 0.4, 0.8, 0.8, 1.6),
        prior_radii=(0.04, 0.08, 0.08, 0.16, 0.16, 0.32, 0.32, 0.64),
        thickness=4,
        structure=64,
        structure_widths=(128, 128),
    ),
}
