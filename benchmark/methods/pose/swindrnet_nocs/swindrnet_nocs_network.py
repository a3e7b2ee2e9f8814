"""SwinDRNet's pose network (Dai et al., ECCV 2022): configuration and network.

Fuses colour and point features as in the published network.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

from benchmark.methods.depth.swindrnet import swin
from benchmark.methods.depth.swindrnet.fusion_decoder import (
    CrossAttentionLayer,
    CrossBlock,
    DetailDecoder,
    PaperFusion,
    enlarged,
)
from benchmark.methods.depth.swindrnet.swindrnet_network import SwinStreams
from benchmark.methods.network import COMPACT_SIZE
from benchmark.methods.pose.fitting import FitSettings
from benchmark.methods.relative_depth import network_depth, relative_color

# Numbers of the segmentation: 0 other, 1 to 7 the classes of DREDS, 8 background.
CLASSES = 9

BACKGROUND_CLASS = 8

# The streams' names and the channels of the images that they get: x y z, or depth and whether
# there is any.
_POINT_IMAGES = {"backbone_rgb_branch": 3, "backbone_xyz_branch": 3}

_DEPTH_IMAGES = {"backbone_rgb_branch": 3, "backbone_xyz_branch": 2}

# What the first answers are about: background, as most pixels are, and the cube's middle. Weights
# as small as those of restored depth, which begins as the sensor's, would keep them there for long.
BACKGROUND_FIRST, MIDDLE = 3.0, 0.5

_SPREAD = 0.25


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
        trunk: whether the streams are the network's `own`, or those of compact `swindrnet`, the
            depth restorer, which are not trained (`trunk_network`).
        trunk_weights: file of the restorer's weights; by default those that ship.
        instances: what counts as an object: all pixels of a `class`, as published, each
            connected `piece` of them, or all pixels that point to the same `middle`.
        least_pixels: pixels of an object at least, at the network's size.
        other: chance of no class from which on an object is left out; for `middle`.
        apart: least distance between the middles of two objects, pixels; for `middle`.
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
    trunk: Literal["own", "swindrnet"] = "own"
    trunk_weights: str | None = None
    instances: Literal["class", "piece", "middle"] = "class"
    least_pixels: int = 10
    other: float = 0.7
    apart: float = 8.0

    @property
    def level_channels(self) -> tuple[int, ...]:
        """Channels of the four levels of one stream."""
        return tuple(self.channels << level for level in range(4))

    @property
    def fused_channels(self) -> tuple[int, ...]:
        """Channels of the four levels that the decoders get."""
        copies = {"released": 1, "paper": 4}[self.fusion]
        return tuple(copies * channels for channels in self.level_channels)


_COMPACT = SwinNOCSConfig(
    fusion="paper",
    channels=32,
    heads=(1, 2, 4, 8),
    head_channels=96,
    details=True,
    drop_path=0.1,
    input_size=COMPACT_SIZE,
)

PRESETS = {
    "published": SwinNOCSConfig(),
    "compact": _COMPACT,
    "small": replace(
        _COMPACT,
        trunk="swindrnet",
        head_channels=64,
        drop_path=0.0,
        instances="middle",
        least_pixels=20,
    ),
}


class SwinNOCSPrediction(NamedTuple):
    """What the network answers.

    Attributes:
        classes: (b, 9, h, w) logits: 0 other, 1 to 7 the classes, 8 background.
        nocs: (b, 3, h, w) normalised coordinates x y z, in [0, 1] on objects; not limited.
        middles: (b, 2, h, w) how far the middle of a pixel's object is away, x and y in pixels;
            None of a network that does not say it.
    """

    classes: Tensor
    nocs: Tensor
    middles: Tensor | None = None


class SwinNOCSNetwork(SwinStreams):
    """`network(color, points)` to `SwinNOCSPrediction`.

    Colour is RGB in [0, 1], not normalised further; points are those of the sensor's depth in the
    camera frame, metres, 0 where it measured nothing.
    """

    config: SwinNOCSConfig
    backbone_rgb_branch: swin.Swin
    backbone_xyz_branch: swin.Swin

    def __init__(self, config: SwinNOCSConfig | None = None) -> None:
        config = config or SwinNOCSConfig()
        images = _DEPTH_IMAGES if config.details else _POINT_IMAGES
        super().__init__(config, images)
        self.decode_head_classes = self.head(CLASSES)
        self.decode_head_nocs = self.head(3)
        if config.details:
            self.details_of_classes = DetailDecoder(config.head_channels, len(images), CLASSES)
            self.details_of_nocs = DetailDecoder(config.head_channels, len(images), 3)
            begin(self.details_of_classes.last, {BACKGROUND_CLASS: BACKGROUND_FIRST})
            begin(self.details_of_nocs.last, dict.fromkeys(range(3), MIDDLE))
        self.add_fusion(self._fusion)

    def forward(self, color: Tensor, points: Tensor) -> SwinNOCSPrediction:
        """(b, 3, h, w) and (b, 3, h, w)."""
        levels, details = self.features_of(self._images(color, points))
        classes, nocs = self.decode_head_classes(levels), self.decode_head_nocs(levels)
        if self.config.details:
            classes = self.details_of_classes(classes, details)
            nocs = self.details_of_nocs(nocs, details)
        return SwinNOCSPrediction(enlarged(classes, color), enlarged(nocs, color))

    def _images(self, color: Tensor, points: Tensor) -> list[Tensor]:
        """What each stream is shown."""
        if not self.config.details:
            return [color, points]
        depth = points[:, 2:]
        return [relative_color(color), torch.cat([network_depth(depth), depth > 0], dim=1)]

    def _fusion(self, level: int, channels: int) -> nn.Module:
        config = self.config
        if config.fusion == "paper":
            return PaperFusion(channels, config.fusion_heads, config.fusion_window)
        return AttendingFusion(channels, config.depths[level], config.heads[level], config.window)


def begin(last: nn.Conv2d, answers: Mapping[int, float]) -> None:
    """Begin a layer with answers of some of its channels."""
    nn.init.normal_(last.weight, std=_SPREAD)
    assert last.bias is not None
    with torch.no_grad():
        for channel, answer in answers.items():
            last.bias[channel] = answer


class AttendingFusion(nn.Module):
    """What the published program computes for poses; keys and shapes are those of its weights.

    Blocks as those of SwinDRNet's released fusion. In every second one, whose windows are shifted,
    the attention counts: queries of points, keys and values of colour, and what comes of it goes
    to both. The other blocks, and the other direction, have parameters that receive no gradient.

    Args:
        channels: C, of each input.
        depth: blocks.
        heads: of the attention.
        window: side of its windows, in tokens.
    """

    def __init__(self, channels: int, depth: int, heads: int, window: int) -> None:
        super().__init__()
        self.cross_attn_layer = CrossAttentionLayer(
            channels,
            (
                _CrossBlock(channels, heads, window, window // 2 * (index % 2))
                for index in range(depth)
            ),
        )
        self.norm_layer = nn.LayerNorm(channels)

    def forward(self, color: Tensor, points: Tensor) -> Tensor:
        """(b, h, w, C) and (b, h, w, C) to (b, h, w, C)."""
        return self.norm_layer(self.cross_attn_layer(color, points))


class _CrossBlock(CrossBlock):
    def __init__(self, channels: int, heads: int, window: int, shift: int) -> None:
        super().__init__(channels, _CrossAttention(channels, heads, window))
        self.window, self.shift = window, shift

    def change(self, color: Tensor, depth: Tensor) -> Tensor:
        if not self.shift:
            return super().change(color, depth)
        return self._attend(self.norm1_branch_1(color), self.norm1_branch_2(depth))

    def _attend(self, color: Tensor, points: Tensor) -> Tensor:
        h, w = color.shape[1:3]
        color, points = (
            torch.roll(swin.padded(tokens, self.window), (-self.shift, -self.shift), (1, 2))
            for tokens in (color, points)
        )
        high, wide = color.shape[1:3]
        mask = swin.shift_mask(high, wide, self.window, self.shift, color.device)
        windows = (swin.to_windows(tokens, self.window) for tokens in (color, points))
        attended = swin.from_windows(self.attn(*windows, mask), self.window, high, wide)
        return torch.roll(attended, (self.shift, self.shift), (1, 2))[:, :h, :w]


class _CrossAttention(nn.Module):
    """From points to colour; what is numbered 2 and is not for queries is never used."""

    relative_position_index: Tensor

    def __init__(self, channels: int, heads: int, window: int) -> None:
        super().__init__()
        self.heads = heads
        rows = (2 * window - 1) ** 2
        self.relative_position_bias_table_1 = nn.Parameter(torch.zeros(rows, heads))
        self.relative_position_bias_table_2 = nn.Parameter(torch.zeros(rows, heads))
        nn.init.trunc_normal_(self.relative_position_bias_table_1, std=0.02)
        self.register_buffer("relative_position_index", swin.relative_index(window))
        self.qkv_branch_1 = nn.Linear(channels, 3 * channels)
        self.qkv_branch_2 = nn.Linear(channels, 3 * channels)
        self.proj_branch_1 = nn.Linear(channels, channels)
        self.proj_branch_2 = nn.Linear(channels, channels)

    def forward(self, color: Tensor, points: Tensor, mask: Tensor) -> Tensor:
        """(b * windows, n, c) tokens of both; mask (windows, n, n) is added to the attention."""
        count, n, c = color.shape
        q = self._parts(self.qkv_branch_2(points))[0]
        _, k, v = self._parts(self.qkv_branch_1(color))
        bias = self.relative_position_bias_table_1[self.relative_position_index.flatten()]
        bias = bias.reshape(1, n, n, self.heads).permute(0, 3, 1, 2)
        bias = (bias + mask[:, None]).repeat(count // len(mask), 1, 1, 1)
        attended = scaled_dot_product_attention(q, k, v, attn_mask=bias.to(q.dtype))
        return self.proj_branch_1(attended.transpose(1, 2).reshape(count, n, c))

    def _parts(self, qkv: Tensor) -> tuple[Tensor, ...]:
        count, n, c = qkv.shape
        parts = qkv.reshape(count, n, 3, self.heads, c // 3 // self.heads)
        return parts.permute(2, 0, 3, 1, 4).unbind(0)
