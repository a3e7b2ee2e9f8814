"""Positions and directions as waves of several lengths (Mildenhall et al., ECCV 2020)."""

from __future__ import annotations

import torch
from torch import Tensor

POSITION_WAVES = 8
DIRECTION_WAVES = 4


def encoded_size(waves: int) -> int:
    """Numbers that three become."""
    return 3 + 3 * 2 * waves


def encoded(numbers: Tensor, waves: int) -> Tensor:
    """(n, 3) numbers to (n, 3 + 6 waves): themselves, then sine and cosine of 1, 2, 4, ... times.

    As published, the numbers are not multiplied by pi.
    """
    sine, cosine = numbers.sin(), numbers.cos()
    parts = [numbers, sine, cosine]
    for _ in range(waves - 1):
        # Of the doubled angle; sines of every angle by themselves take a fifth of all the time.
        sine, cosine = 2 * sine * cosine, 1 - 2 * sine * sine
        parts += [sine, cosine]
    return torch.cat(parts, dim=1)
