"""Swin transformer (Liu et al., ICCV 2021) as a backbone of four levels.

Keys and shapes match the published ImageNet weights.
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import pad, scaled_dot_product_attention

from benchmark.methods.network import precisely

PATCH = 4

_MLP_RATIO = 4


def to_windows(tokens: Tensor, side: int) -> Tensor:
    """(b, h, w, c) tokens as (b * windows, side * side, c); h and w are multiples of `side`."""
    b, h, w, c = tokens.shape
    tokens = tokens.reshape(b, h // side, side, w // side, side, c)
    return tokens.transpose(2, 3).reshape(-1, side * side, c)


def from_windows(windows: Tensor, side: int, h: int, w: int) -> Tensor:
    """The inverse of `to_windows`."""
    c = windows.shape[-1]
    tokens = windows.reshape(-1, h // side, w // side, side, side, c)
    return tokens.transpose(2, 3).reshape(-1, h, w, c)


def padded(tokens: Tensor, side: int) -> Tensor:
    """(b, h, w, c) tokens with zeros added right and below up to multiples of `side`."""
    h, w = tokens.shape[1:3]
    right, below = -w % side, -h % side
    return pad(tokens, (0, 0, 0, right, 0, below)) if right or below else tokens


def relative_index(side: int) -> Tensor:
    """For each two tokens of a window the row of the table of relative biases: (n, n) with
    n = side * side, of (2 side - 1)^2 rows in the order of dy, then dx."""
    y, x = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    y, x = y.flatten(), x.flatten()
    dy = y[:, None] - y[None] + side - 1
    dx = x[:, None] - x[None] + side - 1
    return dy * (2 * side - 1) + dx


def shift_mask(h: int, w: int, side: int, shift: int, device: torch.device) -> Tensor:
    """What keeps apart tokens that only the roll by `shift` brought into one window.

    Returns:
        (windows, n, n) float32, -100 between tokens of different parts of the image, 0 elsewhere.
    """
    strip_y = _strips(h, side, shift, device)
    strip_x = _strips(w, side, shift, device)
    part = (strip_y[:, None] * 3 + strip_x[None]).reshape(1, h, w, 1)
    of_window = to_windows(part, side)[..., 0]
    return (of_window[:, :, None] != of_window[:, None, :]).float() * -100.0


def _strips(length: int, side: int, shift: int, device: torch.device) -> Tensor:
    at = torch.arange(length, device=device)
    return (at >= length - side).long() + (at >= length - shift).long()


class Swin(nn.Module):
    """A pyramid of features of an image.

    Args:
        channels: of the first level; each next one has twice as many and half the resolution.
        depths, heads: blocks and attention heads of each level.
        window: side of the windows in tokens.
        in_channels: of the image.
        drop_path: chance to leave the last block out in training; it rises from 0 in the first.
        patch: side of the pixels of a token.
    """

    def __init__(
        self,
        channels: int = 96,
        depths: tuple[int, ...] = (2, 2, 6, 2),
        heads: tuple[int, ...] = (3, 6, 12, 24),
        window: int = 7,
        in_channels: int = 3,
        drop_path: float = 0.2,
        patch: int = PATCH,
    ) -> None:
        super().__init__()
        self.patch_embed = PatchEmbedding(in_channels, channels, patch)
        last = max(sum(depths) - 1, 1)
        chances = (drop_path * index / last for index in range(sum(depths)))
        self.layers = nn.ModuleList(
            Stage(
                channels << level,
                [next(chances) for _ in range(depth)],
                heads[level],
                window,
                downsample=level + 1 < len(depths),
            )
            for level, depth in enumerate(depths)
        )
        for level in range(len(depths)):
            self.add_module(f"norm{level}", nn.LayerNorm(channels << level))
        self.apply(_initialise)

    def forward(self, image: Tensor) -> list[Tensor]:
        """(b, c, h, w) image to the levels' features (b, h / patch, w / patch, channels) ..."""
        tokens = self.patch_embed(image)
        levels = []
        for index, stage in enumerate(self.layers):
            whole, tokens = stage(tokens)
            levels.append(self.get_submodule(f"norm{index}")(whole))
        return levels


class PatchEmbedding(nn.Module):
    """A token for every square of pixels."""

    def __init__(self, in_channels: int, channels: int, patch: int) -> None:
        super().__init__()
        self.patch = patch
        self.proj = nn.Conv2d(in_channels, channels, patch, patch)
        self.norm = nn.LayerNorm(channels)

    def forward(self, image: Tensor) -> Tensor:
        h, w = image.shape[-2:]
        if h % self.patch or w % self.patch:
            image = pad(image, (0, -w % self.patch, 0, -h % self.patch))
        return self.norm(precisely(self.proj, image).permute(0, 2, 3, 1))


class Stage(nn.Module):
    """The blocks of one level, whose windows are shifted in every second one."""

    def __init__(
        self, channels: int, drops: list[float], heads: int, window: int, *, downsample: bool
    ) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(
            Block(channels, heads, window, window // 2 * (index % 2), drop)
            for index, drop in enumerate(drops)
        )
        self.downsample = PatchMerging(channels) if downsample else nn.Identity()

    def forward(self, tokens: Tensor) -> tuple[Tensor, Tensor]:
        """The tokens after the blocks, and those that the next level begins with."""
        for block in self.blocks:
            tokens = block(tokens)
        return tokens, self.downsample(tokens)


class Block(nn.Module):
    """Attention within windows, then a perceptron."""

    def __init__(self, channels: int, heads: int, window: int, shift: int, drop: float) -> None:
        super().__init__()
        self.window, self.shift, self.drop = window, shift, drop
        self.norm1 = nn.LayerNorm(channels)
        self.attn = WindowAttention(channels, heads, window)
        self.norm2 = nn.LayerNorm(channels)
        self.mlp = Perceptron(channels)

    def forward(self, tokens: Tensor) -> Tensor:
        tokens = tokens + drop_path(self._attend(self.norm1(tokens)), self.drop, self.training)
        return tokens + drop_path(self.mlp(self.norm2(tokens)), self.drop, self.training)

    def _attend(self, tokens: Tensor) -> Tensor:
        h, w = tokens.shape[1:3]
        tokens = padded(tokens, self.window)
        high, wide = tokens.shape[1:3]
        mask = None
        if self.shift:
            tokens = torch.roll(tokens, (-self.shift, -self.shift), (1, 2))
            mask = shift_mask(high, wide, self.window, self.shift, tokens.device)
        attended = self.attn(to_windows(tokens, self.window), mask)
        tokens = from_windows(attended, self.window, high, wide)
        if self.shift:
            tokens = torch.roll(tokens, (self.shift, self.shift), (1, 2))
        return tokens[:, :h, :w]


class WindowAttention(nn.Module):
    """Attention of several heads among the tokens of a window, with a bias by their offset."""

    relative_position_index: Tensor

    def __init__(self, channels: int, heads: int, window: int) -> None:
        super().__init__()
        self.heads = heads
        self.relative_position_bias_table = nn.Parameter(torch.zeros((2 * window - 1) ** 2, heads))
        self.register_buffer("relative_position_index", relative_index(window))
        self.qkv = nn.Linear(channels, 3 * channels)
        self.proj = nn.Linear(channels, channels)
        nn.init.trunc_normal_(self.relative_position_bias_table, std=0.02)

    def forward(self, tokens: Tensor, mask: Tensor | None) -> Tensor:
        """(b * windows, n, c) tokens; mask (windows, n, n) is added to the attention."""
        count, n, c = tokens.shape
        qkv = self.qkv(tokens).reshape(count, n, 3, self.heads, c // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)
        bias = self.relative_position_bias_table[self.relative_position_index.flatten()]
        bias = bias.reshape(1, n, n, self.heads).permute(0, 3, 1, 2)
        if mask is not None:
            bias = (bias + mask[:, None]).repeat(count // len(mask), 1, 1, 1)
        attended = scaled_dot_product_attention(q, k, v, attn_mask=bias.to(q.dtype))
        return self.proj(attended.transpose(1, 2).reshape(count, n, c))


class Perceptron(nn.Module):
    """Two layers with GELU between them."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(channels, _MLP_RATIO * channels)
        self.fc2 = nn.Linear(_MLP_RATIO * channels, channels)

    def forward(self, tokens: Tensor) -> Tensor:
        return self.fc2(nn.functional.gelu(self.fc1(tokens)))


class PatchMerging(nn.Module):
    """Half the resolution, twice the channels."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(4 * channels)
        self.reduction = nn.Linear(4 * channels, 2 * channels, bias=False)

    def forward(self, tokens: Tensor) -> Tensor:
        tokens = padded(tokens, 2)
        b, h, w, c = tokens.shape
        # The published order of the four tokens: down the columns.
        four = tokens.reshape(b, h // 2, 2, w // 2, 2, c).permute(0, 1, 3, 4, 2, 5)
        return self.reduction(self.norm(four.reshape(b, h // 2, w // 2, 4 * c)))


def drop_path(tokens: Tensor, chance: float, training: bool) -> Tensor:
    """In training, zero for some images of the batch, the others scaled to keep the mean."""
    if not training or chance == 0:
        return tokens
    shape = (len(tokens),) + (1,) * (tokens.dim() - 1)
    return tokens * tokens.new_empty(shape).bernoulli_(1 - chance).div_(1 - chance)


def _initialise(module: nn.Module) -> None:
    if isinstance(module, nn.Linear):
        nn.init.trunc_normal_(module.weight, std=0.02)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
