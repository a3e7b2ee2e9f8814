"""How features of colour and of points meet in the published pose network."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

from benchmark.methods.swindrnet.swin import Perceptron
from benchmark.methods.swindrnet.windows import (
    from_windows,
    padded,
    relative_index,
    shift_mask,
    to_windows,
)


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
        self.cross_attn_layer = _CrossAttentionLayer(channels, depth, heads, window)
        self.norm_layer = nn.LayerNorm(channels)

    def forward(self, color: Tensor, points: Tensor) -> Tensor:
        """(b, h, w, C) and (b, h, w, C) to (b, h, w, C)."""
        return self.norm_layer(self.cross_attn_layer(color, points))


class _CrossAttentionLayer(nn.Module):
    def __init__(self, channels: int, depth: int, heads: int, window: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(
            _CrossBlock(channels, heads, window, window // 2 * (index % 2))
            for index in range(depth)
        )
        self.fuse = nn.Linear(2 * channels, channels)

    def forward(self, color: Tensor, points: Tensor) -> Tensor:
        for block in self.blocks:
            color, points = block(color, points)
        return self.fuse(torch.cat([color, points], dim=-1))


class _CrossBlock(nn.Module):
    def __init__(self, channels: int, heads: int, window: int, shift: int) -> None:
        super().__init__()
        self.window, self.shift = window, shift
        self.norm1_branch_1 = nn.LayerNorm(channels)
        self.norm1_branch_2 = nn.LayerNorm(channels)
        self.attn = _CrossAttention(channels, heads, window)
        self.norm2_branch_1 = nn.LayerNorm(channels)
        self.norm2_branch_2 = nn.LayerNorm(channels)
        self.mlp_branch_1 = Perceptron(channels)
        self.mlp_branch_2 = Perceptron(channels)

    def forward(self, color: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        change = self.norm1_branch_1(color)
        if self.shift:
            change = self._attend(change, self.norm1_branch_2(points))
        color = color + change
        points = points + color
        color = color + self.mlp_branch_1(self.norm2_branch_1(color))
        points = points + self.mlp_branch_2(self.norm2_branch_2(points))
        return color, points

    def _attend(self, color: Tensor, points: Tensor) -> Tensor:
        h, w = color.shape[1:3]
        color, points = (
            torch.roll(padded(tokens, self.window), (-self.shift, -self.shift), (1, 2))
            for tokens in (color, points)
        )
        high, wide = color.shape[1:3]
        mask = shift_mask(high, wide, self.window, self.shift, color.device)
        windows = (to_windows(tokens, self.window) for tokens in (color, points))
        attended = from_windows(self.attn(*windows, mask), self.window, high, wide)
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
        self.register_buffer("relative_position_index", relative_index(window))
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
