"""Filters of a disparity map with holes, on any device; equal to `numba_filters`."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad


def median(disparity: Tensor, side: int) -> Tensor:
    """(H, W): of every valid pixel the (lower) median of the valid ones in side x side."""
    height, width = disparity.shape
    radius = side // 2
    padded = pad(disparity, (radius,) * 4)
    around = torch.stack(
        [padded[v : v + height, u : u + width] for v in range(side) for u in range(side)]
    )
    valid = around > 0
    # Holes sort behind everything.
    ordered = torch.where(valid, around, torch.inf).sort(dim=0).values
    middle = ((valid.sum(0) - 1) // 2).clamp(min=0)
    found = ordered.gather(0, middle[None])[0]
    return torch.where(disparity > 0, found, torch.zeros_like(found))


def remove_speckles(disparity: Tensor, smallest: int, step: float) -> Tensor:
    """(H, W) without connected patches of fewer than `smallest` valid pixels.

    Every pixel takes the least label of its neighbours in turn, and then the label of its label,
    until nothing changes: some tens of rounds, as the paths halve.
    """
    height, width = disparity.shape
    labels = torch.arange(height * width, device=disparity.device)
    grid = labels.view(height, width)
    right = _connected(disparity[:, :-1], disparity[:, 1:], step)
    down = _connected(disparity[:-1], disparity[1:], step)
    pairs = torch.cat(
        [
            torch.stack([grid[:, :-1][right], grid[:, 1:][right]]),
            torch.stack([grid[:-1][down], grid[1:][down]]),
        ],
        dim=1,
    )
    while True:
        roots = labels[pairs]
        low, high = roots.amin(0), roots.amax(0)
        if bool((low == high).all()):
            break
        labels = labels.scatter_reduce(0, high, low, "amin")
        while True:
            jumped = labels[labels]
            if bool((jumped == labels).all()):
                break
            labels = jumped
    size = torch.zeros_like(labels).scatter_add_(0, labels, torch.ones_like(labels))
    large = (size[labels] >= smallest).view(height, width)
    return torch.where(large, disparity, torch.zeros_like(disparity))


def _connected(a: Tensor, b: Tensor, step: float) -> Tensor:
    return (a > 0) & (b > 0) & ((a - b).abs() <= step)
