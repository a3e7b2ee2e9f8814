"""Which measurements stand for an image: some of every part of it."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

_BLOCK = 8


def spread(valid: Tensor, limit: int) -> Tensor:
    """Valid pixels, evenly over each image.

    From every block of 8x8 pixels one is taken, then a second far from the first, and so on. Where
    fewer than `limit` are valid all are taken; the published program repeats some to fill up,
    which changes nothing: only the largest features of a voxel count.

    Args:
        valid: (b, h, w) bool.
        limit: pixels per image, at most.

    Returns:
        (n,) indices into the flat batch, image by image.
    """
    b, h, w = valid.shape
    order = _order(h, w).to(valid.device)
    found = []
    for index in range(b):
        flat = valid[index].flatten()
        found.append(order[flat[order]][:limit] + index * h * w)
    return torch.cat(found)


@lru_cache(maxsize=4)
def _order(h: int, w: int) -> Tensor:
    """(h w,) flat pixels: first one of every block, then the second ones."""
    turns = _turns(_BLOCK).repeat(-(-h // _BLOCK), -(-w // _BLOCK))[:h, :w]
    return torch.argsort(turns.flatten(), stable=True)


def _turns(side: int) -> Tensor:
    """(side, side) order in which a block's pixels are taken: that of ordered dithering."""
    if side == 1:
        return torch.zeros(1, 1, dtype=torch.long)
    quarter = 4 * _turns(side // 2)
    return torch.cat(
        [torch.cat([quarter, quarter + 2], 1), torch.cat([quarter + 3, quarter + 1], 1)]
    )
