"""How SwinDRNet's features of colour and of depth meet at one level."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

from benchmark.methods.swindrnet.swin import Perceptron
from benchmark.methods.swindrnet.windows import from_windows, padded, relative_index, to_windows


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
            tokens = to_windows(padded(qkv, self.window), self.window)
        count, n, c = tokens.shape
        parts = tokens.reshape(count, n, 3, self.heads, c // 3 // self.heads)
        return parts.permute(2, 0, 3, 1, 4).unbind(0)

    def _join(self, attended: Tensor, like: Tensor) -> Tensor:
        tokens = attended.transpose(1, 2).flatten(2)
        if self.window is None:
            return tokens.reshape(like.shape)
        h, w = like.shape[1:3]
        high, wide = h + -h % self.window, w + -w % self.window
        return from_windows(tokens, self.window, high, wide)[:, :h, :w]


class ReleasedFusion(nn.Module):
    """What the published program computes; keys and shapes are those of its weights.

    It has attention within windows, but overwrites what comes of it with what went in: only the
    parts below take part, and a pixel depends on no other. The attention's parameters are kept,
    as the published weights hold them; they receive no gradient.
    """

    def __init__(self, channels: int, window: int) -> None:
        super().__init__()
        self.cross_attn_layer = _CrossAttentionLayer(channels, window)
        self.norm_layer = nn.LayerNorm(channels)

    def forward(self, color: Tensor, depth: Tensor) -> Tensor:
        """(b, h, w, C) and (b, h, w, C) to (b, h, w, 3C)."""
        fused = self.norm_layer(self.cross_attn_layer(color, depth))
        return torch.cat([fused, color, depth], dim=-1)


class _CrossAttentionLayer(nn.Module):
    def __init__(self, channels: int, window: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList([_CrossBlock(channels, window)])
        self.fuse = nn.Linear(2 * channels, channels)

    def forward(self, color: Tensor, depth: Tensor) -> Tensor:
        for block in self.blocks:
            color, depth = block(color, depth)
        return self.fuse(torch.cat([color, depth], dim=-1))


class _CrossBlock(nn.Module):
    def __init__(self, channels: int, window: int) -> None:
        super().__init__()
        self.norm1_branch_1 = nn.LayerNorm(channels)
        self.norm1_branch_2 = nn.LayerNorm(channels)
        self.attn = _IdleAttention(channels, window)
        self.norm2_branch_1 = nn.LayerNorm(channels)
        self.norm2_branch_2 = nn.LayerNorm(channels)
        self.mlp_branch_1 = Perceptron(channels)
        self.mlp_branch_2 = Perceptron(channels)

    def forward(self, color: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        color = color + self.norm1_branch_1(color)
        depth = depth + color
        color = color + self.mlp_branch_1(self.norm2_branch_1(color))
        depth = depth + self.mlp_branch_2(self.norm2_branch_2(depth))
        return color, depth


class _IdleAttention(nn.Module):
    """The parameters of the attention that the published program does not use."""

    def __init__(self, channels: int, window: int) -> None:
        super().__init__()
        rows = (2 * window - 1) ** 2
        self.relative_position_bias_table_1 = nn.Parameter(torch.zeros(rows, 1))
        self.relative_position_bias_table_2 = nn.Parameter(torch.zeros(rows, 1))
        self.register_buffer("relative_position_index", relative_index(window))
        self.qkv_branch_1 = nn.Linear(channels, 3 * channels)
        self.qkv_branch_2 = nn.Linear(channels, 3 * channels)
        self.proj_branch_1 = nn.Linear(channels, channels)
        self.proj_branch_2 = nn.Linear(channels, channels)
