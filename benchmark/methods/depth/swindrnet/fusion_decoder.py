"""Fusion of colour and depth features, and the UPerNet decoder (Xiao et al., ECCV 2018).

Keys and shapes match the published weights.

The published network has one linear map of 4x4 pixels before its transformers and answers at a
quarter of the resolution. The compact one has convolutions before the transformers, with which it
learns faster (Xiao et al., NeurIPS 2021), and uses their features to restore the full resolution
(U-Net, Ronneberger et al., MICCAI 2015).
"""

from collections.abc import Iterable, Iterator, Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, scaled_dot_product_attention

from benchmark.methods.depth.swindrnet import swin
from benchmark.methods.network import precisely

_WIDTHS = (12, 24, 48)  # channels at the image's resolution, at half and at a quarter of it

_WAY_BACK = (16, 16, 48)  # likewise

BEFORE_TOKENS = _WIDTHS[-1]

TOKEN_OF_DETAILS = 2  # side, pixels of the last details


class PaperFusion(nn.Module):
    """The paper's fusion: colour attends to depth, depth attends to colour.

    `softmax(Q K^T / sqrt(d)) V` with the queries of one and the keys and values of the other, both
    ways. The level's feature is [colour to depth, depth to colour, colour, depth]: 4C channels.

    Args:
        channels: C, of each input.
        heads: of the attention.
        window: side of the windows to attend within; None for the whole image, as in the paper.
    """

    def __init__(self, channels: int, heads: int, window: int | None) -> None:
        super().__init__()
        self.heads, self.window = heads, window
        self.color_qkv = nn.Linear(channels, 3 * channels)
        self.depth_qkv = nn.Linear(channels, 3 * channels)
        for layer in (self.color_qkv, self.depth_qkv):
            nn.init.trunc_normal_(layer.weight, std=0.02)
            nn.init.zeros_(layer.bias)

    def forward(self, color: Tensor, depth: Tensor) -> Tensor:
        """(b, h, w, C) and (b, h, w, C) to (b, h, w, 4C)."""
        q_color, k_color, v_color = self._split(self.color_qkv(color))
        q_depth, k_depth, v_depth = self._split(self.depth_qkv(depth))
        to_depth = self._join(scaled_dot_product_attention(q_color, k_depth, v_depth), color)
        to_color = self._join(scaled_dot_product_attention(q_depth, k_color, v_color), color)
        return torch.cat([to_depth, to_color, color, depth], dim=-1)

    def _split(self, qkv: Tensor) -> tuple[Tensor, ...]:
        """(b, h, w, 3C) to queries, keys and values (windows, heads, tokens, C / heads)."""
        if self.window is None:
            tokens = qkv.flatten(1, 2)
        else:
            tokens = swin.to_windows(swin.padded(qkv, self.window), self.window)
        count, n, c = tokens.shape
        parts = tokens.reshape(count, n, 3, self.heads, c // 3 // self.heads)
        return parts.permute(2, 0, 3, 1, 4).unbind(0)

    def _join(self, attended: Tensor, like: Tensor) -> Tensor:
        tokens = attended.transpose(1, 2).flatten(2)
        if self.window is None:
            return tokens.reshape(like.shape)
        h, w = like.shape[1:3]
        high, wide = h + -h % self.window, w + -w % self.window
        return swin.from_windows(tokens, self.window, high, wide)[:, :h, :w]


class ReleasedFusion(nn.Module):
    """What the published program computes; keys and shapes are those of its weights.

    It has attention within windows, but overwrites what comes of it with what went in: only the
    parts below take part, and a pixel depends on no other. The attention's parameters are kept,
    as the published weights hold them; they receive no gradient.
    """

    def __init__(self, channels: int, window: int) -> None:
        super().__init__()
        block = CrossBlock(channels, IdleAttention(channels, window))
        self.cross_attn_layer = CrossAttentionLayer(channels, [block])
        self.norm_layer = nn.LayerNorm(channels)

    def forward(self, color: Tensor, depth: Tensor) -> Tensor:
        """(b, h, w, C) and (b, h, w, C) to (b, h, w, 3C)."""
        fused = self.norm_layer(self.cross_attn_layer(color, depth))
        return torch.cat([fused, color, depth], dim=-1)


class CrossAttentionLayer(nn.Module):
    """Blocks over two streams (b, h, w, C), and what fuses them."""

    def __init__(self, channels: int, blocks: Iterable[nn.Module]) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(blocks)
        self.fuse = nn.Linear(2 * channels, channels)

    def forward(self, color: Tensor, depth: Tensor) -> Tensor:
        for block in self.blocks:
            color, depth = block(color, depth)
        return self.fuse(torch.cat([color, depth], dim=-1))


class CrossBlock(nn.Module):
    """A block over two streams; its attention has parameters alone."""

    def __init__(self, channels: int, attention: nn.Module) -> None:
        super().__init__()
        self.norm1_branch_1 = nn.LayerNorm(channels)
        self.norm1_branch_2 = nn.LayerNorm(channels)
        self.attn = attention
        self.norm2_branch_1 = nn.LayerNorm(channels)
        self.norm2_branch_2 = nn.LayerNorm(channels)
        self.mlp_branch_1 = swin.Perceptron(channels)
        self.mlp_branch_2 = swin.Perceptron(channels)

    def forward(self, color: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        color = color + self.change(color, depth)
        depth = depth + color
        color = color + self.mlp_branch_1(self.norm2_branch_1(color))
        depth = depth + self.mlp_branch_2(self.norm2_branch_2(depth))
        return color, depth

    def change(self, color: Tensor, depth: Tensor) -> Tensor:  # noqa: ARG002
        """What is added to the first stream."""
        return self.norm1_branch_1(color)


class IdleAttention(nn.Module):
    """The parameters of the attention that the published program does not use."""

    def __init__(self, channels: int, window: int) -> None:
        super().__init__()
        rows = (2 * window - 1) ** 2
        self.relative_position_bias_table_1 = nn.Parameter(torch.zeros(rows, 1))
        self.relative_position_bias_table_2 = nn.Parameter(torch.zeros(rows, 1))
        self.register_buffer("relative_position_index", swin.relative_index(window))
        self.qkv_branch_1 = nn.Linear(channels, 3 * channels)
        self.qkv_branch_2 = nn.Linear(channels, 3 * channels)
        self.proj_branch_1 = nn.Linear(channels, channels)
        self.proj_branch_2 = nn.Linear(channels, channels)


class ConvUnit(nn.Module):
    """Convolution, batch normalisation, ReLU; a stride of 1 keeps the size."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
        self.bn = nn.BatchNorm2d(outputs)

    def forward(self, features: Tensor) -> Tensor:
        return nn.functional.relu(self.bn(self.conv(features)))


class UPerHead(nn.Module):
    """Four levels to one map at the resolution of the first.

    Args:
        inputs: channels of the levels.
        channels: of the decoder.
        outputs: channels of the map.
        pool_scales: sides of the pooled pyramid of the last level.
        dropout: chance of a channel to be left out before the last convolution in training.
    """

    def __init__(
        self,
        inputs: Sequence[int],
        channels: int,
        outputs: int,
        pool_scales: Sequence[int],
        dropout: float,
    ) -> None:
        super().__init__()
        *lower, top = inputs
        self.psp_modules = nn.ModuleList(
            nn.Sequential(nn.AdaptiveAvgPool2d(scale), ConvUnit(top, channels, 1))
            for scale in pool_scales
        )
        self.bottleneck = ConvUnit(top + len(pool_scales) * channels, channels, 3)
        self.lateral_convs = nn.ModuleList(ConvUnit(width, channels, 1) for width in lower)
        self.fpn_convs = nn.ModuleList(ConvUnit(channels, channels, 3) for _ in lower)
        self.fpn_bottleneck = ConvUnit(len(inputs) * channels, channels, 3)
        self.dropout = nn.Dropout2d(dropout)
        self.conv_seg = nn.Conv2d(channels, outputs, 1)
        nn.init.normal_(self.conv_seg.weight, std=0.01)
        self.conv_seg.bias = nn.Parameter(torch.zeros(outputs))

    def forward(self, levels: Sequence[Tensor]) -> Tensor:
        """(b, c, h, w) levels, each half the size of the one before, to (b, outputs, h, w)."""
        top = levels[-1]
        means = [enlarged(module(top), top) for module in self.psp_modules]
        features = [conv(level) for conv, level in zip(self.lateral_convs, levels, strict=False)]
        features.append(self.bottleneck(torch.cat([top, *means], dim=1)))
        for index in range(len(features) - 1, 0, -1):
            below = features[index - 1]
            features[index - 1] = below + enlarged(features[index], below)
        for index, conv in enumerate(self.fpn_convs):
            features[index] = conv(features[index])
        features = [features[0], *(enlarged(feature, features[0]) for feature in features[1:])]
        fused = self.dropout(self.fpn_bottleneck(torch.cat(features, dim=1)))
        return precisely(self.conv_seg, fused)


def enlarged(features: Tensor, like: Tensor) -> Tensor:
    """Bilinear enlargement to the size of `like`, corners not aligned."""
    if features.shape[-2:] == like.shape[-2:]:
        return features
    return interpolate(features, size=like.shape[-2:], mode="bilinear", align_corners=False)


class DetailEncoder(nn.Module):
    """An image (b, c, h, w) to its details at the whole, half and quarter of the resolution."""

    def __init__(self, in_channels: int) -> None:
        super().__init__()
        whole, half, quarter = _WIDTHS
        self.to_whole = ConvUnit(in_channels, whole, 3)
        self.to_half = ConvUnit(whole, half, 3, stride=2)
        self.to_quarter = ConvUnit(half, quarter, 3, stride=2)
        self.at_quarter = ConvUnit(quarter, quarter, 3)

    def forward(self, image: Tensor) -> list[Tensor]:
        # Depth in half precision is only accurate to a few millimetres.
        whole = precisely(self.to_whole, image)
        half = self.to_half(whole)
        quarter = self.to_quarter(half)
        return [whole, half, quarter + self.at_quarter(quarter)]


class DetailDecoder(nn.Module):
    """A decoder's map and the details of the streams to a map of the image's resolution.

    Args:
        channels: of the decoder's map.
        streams: how many images' details there are.
        outputs: channels of the output.
    """

    def __init__(self, channels: int, streams: int, outputs: int) -> None:
        super().__init__()
        above = (*_WAY_BACK[1:], channels)
        self.steps = nn.ModuleList(
            ConvUnit(wider + streams * width, own, 3)
            for own, width, wider in zip(_WAY_BACK, _WIDTHS, above, strict=True)
        )
        self.last = nn.Conv2d(_WAY_BACK[0], outputs, 1)
        nn.init.normal_(self.last.weight, std=0.01)
        self.last.bias = nn.Parameter(torch.zeros(outputs))

    def forward(self, found: Tensor, details: Sequence[Tensor]) -> Tensor:
        """(b, channels, h / 8, w / 8) and the streams' details, finest first, together."""
        *_, found = self.maps(found, details)
        return precisely(self.last, found)

    def maps(self, found: Tensor, details: Sequence[Tensor]) -> Iterator[Tensor]:
        """What each step makes, at the resolutions of the details, coarsest first."""
        for step, detail in zip(reversed(self.steps), reversed(details), strict=True):
            found = step(torch.cat([enlarged(found, detail), detail], dim=1))
            yield found
