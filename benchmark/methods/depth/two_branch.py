"""The two-branch baseline of the SwinDRNet paper: Swin transformer on colour, PointNet++ on depth.

The paper prints its speed beside those of depth restorers, 6 frames a second, and says no more than
that the branch on depth is PointNet++. Here the branch on colour, the decoders and the confidence
are those of SwinDRNet, so that the branch on depth is what differs. PointNet++ has the sizes of its
own paper (Qi et al., NeurIPS 2017).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from benchmark.methods import network, relative_depth
from benchmark.methods.depth.swindrnet.fusion_decoder import enlarged
from benchmark.methods.depth.swindrnet.swindrnet_network import SwinStreams, blended
from benchmark.methods.pointnet.grouping import at
from benchmark.methods.pointnet.layers import (
    FeaturePropagation,
    Scale,
    SetAbstraction,
    interpolated,
)
from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions

_LEVELS = 4

_COLOR = "backbone_rgb_branch"


@dataclass(frozen=True, kw_only=True)
class TwoBranchConfig:
    """The two-branch baseline; the defaults have the sizes of the published SwinDRNet.

    Attributes:
        channels, depths, heads, window, head_channels, pool_scales, relative, drop_path, dropout,
            input_size: as of SwinDRNet. Where `relative` is set, points are divided by the mean
            depth of the image.
        points: points of an image, of the measured pixels.
        centres: points that are left at each of four levels.
        radii: of the neighbourhoods at each level, in the unit of the points.
        neighbours: in each of them.
        point_channels: of the first level; each next one has twice as many.
    """

    channels: int = 96
    depths: tuple[int, int, int, int] = (2, 2, 6, 2)
    heads: tuple[int, int, int, int] = (3, 6, 12, 24)
    window: int = 7
    head_channels: int = 512
    pool_scales: tuple[int, ...] = (1, 2, 3, 6)
    relative: bool = False
    drop_path: float = 0.2
    dropout: float = 0.1
    input_size: tuple[int, int] = (224, 224)
    points: int = 4096
    centres: tuple[int, int, int, int] = (1024, 256, 64, 16)
    radii: tuple[float, float, float, float] = (0.04, 0.08, 0.16, 0.32)
    neighbours: int = 32
    point_channels: int = 64

    @property
    def details(self) -> bool:
        """Tokens are linear maps of 4x4 pixels, as in the published SwinDRNet."""
        return False

    @property
    def level_channels(self) -> tuple[int, ...]:
        """Channels of the four levels of colour."""
        return tuple(self.channels << level for level in range(_LEVELS))

    @property
    def fused_channels(self) -> tuple[int, ...]:
        """Channels of the four levels that the decoders get: colour, then points."""
        return tuple((self.channels + self.point_channels) << level for level in range(_LEVELS))


PRESETS = {
    "published": TwoBranchConfig(),
    "compact": TwoBranchConfig(
        channels=32,
        heads=(1, 2, 4, 8),
        head_channels=96,
        relative=True,
        drop_path=0.1,
        input_size=network.COMPACT_SIZE,
        points=2048,
        centres=(512, 128, 32, 8),
        point_channels=32,
    ),
}


class TwoBranchNetwork(SwinStreams):
    """`network(color, depth, rays)` to `Prediction`: depth, initial depth, confidence."""

    config: TwoBranchConfig

    def __init__(self, config: TwoBranchConfig | None = None) -> None:
        config = config or TwoBranchConfig()
        super().__init__(config, {_COLOR: 3})
        self.pointnet = PointBranch(config)
        self.decode_head_depth_restoration = self.head(1)
        self.decode_head_confidence = self.head(2)

    def forward(self, color: Tensor, depth: Tensor, rays: Tensor) -> network.Prediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
            rays: (b, 3, h, w) directions of the pixels with z = 1, camera frame.
        """
        config = self.config
        seen = relative_depth.relative_color(color) if config.relative else color
        of_color = self.features_of([seen]).levels
        of_points = self.pointnet(depth, rays, [level.shape[-2:] for level in of_color])
        levels = [torch.cat(pair, dim=1) for pair in zip(of_color, of_points, strict=True)]
        initial = enlarged(self.decode_head_depth_restoration(levels), depth)
        confidence = enlarged(self.decode_head_confidence(levels), depth)
        if config.relative:
            initial = relative_depth.in_metres(relative_depth.coarse_depth(depth), initial)
            nothing = torch.cat([depth == 0, torch.zeros_like(depth, dtype=torch.bool)], dim=1)
            confidence = confidence.masked_fill(nothing, -torch.inf)
        return blended(depth, initial, confidence)


class PointBranch(nn.Module):
    """PointNet++ on the measured points, and its features at the tokens of four levels."""

    def __init__(self, config: TwoBranchConfig) -> None:
        super().__init__()
        self.config = config
        widths = [config.point_channels << level for level in range(_LEVELS)]
        self.down = nn.ModuleList()
        inputs = 0
        for centres, radius, width in zip(config.centres, config.radii, widths, strict=True):
            scale = Scale(radius, config.neighbours, (width // 2, width // 2, width))
            self.down.append(SetAbstraction(centres, [scale], inputs, normalise=True))
            inputs = width
        # From the coarsest level back to the finest.
        self.up = nn.ModuleList(
            FeaturePropagation(fine + coarse, (fine, fine)) for fine, coarse in pairwise(widths)
        )

    def forward(self, depth: Tensor, rays: Tensor, sizes: Sequence[Sequence[int]]) -> list[Tensor]:
        """(b, c, h, w) features of each level, at these sizes (h, w).

        A token has the features of the three points nearest to it in the image: where nothing was
        measured, those around the hole.
        """
        points, places = sampled(depth, rays, self.config)
        found, features = [], None
        for stage in self.down:
            points, features, chosen = stage(points, features)
            places = at(places.transpose(1, 2), chosen).transpose(1, 2)
            found.append((points, places, features))
        for level in reversed(range(_LEVELS - 1)):
            points, places, features = found[level]
            coarse, _, above = found[level + 1]
            found[level] = points, places, self.up[level](coarse, above, points, features)
        return [
            on_grid(places, features, rays, size)
            for (_, places, features), size in zip(found, sizes, strict=True)
        ]


def sampled(depth: Tensor, rays: Tensor, config: TwoBranchConfig) -> tuple[Tensor, Tensor]:
    """Points (b, n, 3) of measured pixels, and their places in the image (b, n, 3).

    The same pixels of every image are preferred, in a fixed random order. Where fewer than n were
    measured the first one fills the rest; in an image without depth all are at its rays' ends.

    Args:
        depth: (b, 1, h, w) metres.
        rays: (b, 3, h, w) with z = 1; a place is x and y of the ray, and 0.
        config: number of points, and their unit.
    """
    measured = (depth > 0).flatten(1)
    count = measured.shape[1]
    order = torch.randperm(count, generator=torch.Generator().manual_seed(0)).to(depth.device)
    number = torch.where(measured, order, count)
    first = number.topk(min(config.points, count), dim=1, largest=False, sorted=True)
    index = torch.where(first.values < count, first.indices, first.indices[:, :1])
    unit = relative_depth.mean_depth(depth)
    values = torch.where(depth > 0, depth, unit)
    if config.relative:
        values = values / unit
    points = at((rays * values).flatten(2), index).transpose(1, 2)
    on_image = torch.cat([rays[:, :2], torch.zeros_like(rays[:, :1])], dim=1)
    return points, at(on_image.flatten(2), index).transpose(1, 2)


def on_grid(places: Tensor, features: Tensor, rays: Tensor, size: Sequence[int]) -> Tensor:
    """(b, c, h, w) features of points at the tokens of an image of a size (h, w)."""
    middles = interpolate(rays, size=tuple(size), mode="bilinear", align_corners=False)
    wanted = torch.cat([middles[:, :2], torch.zeros_like(middles[:, :1])], dim=1).flatten(2)
    return interpolated(places, features, wanted.transpose(1, 2)).reshape(
        *features.shape[:2], *size
    )


class TwoBranch(network.NetworkRestorer):
    """Swin transformer on colour, PointNet++ on depth; settings are those of `TwoBranchConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = TwoBranchConfig

    def __init__(self, options: MethodOptions) -> None:
        self.config, made = network.network_of("two-branch", PRESETS, TwoBranchNetwork, options)
        super().__init__(made, options, self.config.input_size)

    def inputs(self, views: Sequence[View]) -> tuple[Tensor, ...]:
        """Colour, depth and rays at the input size."""
        color, depth = super().inputs(views)
        rays, reached = network.view_rays(views, depth)
        return color, depth * reached, rays
