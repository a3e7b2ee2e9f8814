"""Square windows of tokens, and attention within them."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad


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
