"""Objects that look the same after a turn: which of the equally right coordinates to learn."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

TURNS = 6  # about y, 60 degrees apart, as published for NOCS and for SwinDRNet's pose network
ROUND = (1, 2, 4)  # bottle, bowl, can; a mug counts by its handle in both published losses
BEND = 0.1  # where the loss of coordinates goes from squares to differences


def is_round(classes: Tensor) -> Tensor:
    """Bool, of the same shape: which class numbers look the same after a turn about y."""
    found = torch.zeros_like(classes, dtype=torch.bool)
    for one in ROUND:
        found |= classes == one
    return found


def turned(nocs: Tensor, turn: Tensor, dim: int) -> Tensor:
    """Normalised coordinates after turns about y through the cube's middle.

    Args:
        nocs: x, y, z in [0, 1] along dimension `dim`.
        turn: which of `TURNS`, of the shape of `nocs` without `dim`, or a scalar.
    """
    angle = turn.to(nocs.dtype) * (2 * math.pi / TURNS)
    cos, sin = angle.cos(), angle.sin()
    x, y, z = (nocs.select(dim, i) for i in range(3))
    x, z = x - 0.5, z - 0.5
    return torch.stack([cos * x + sin * z + 0.5, y, cos * z - sin * x + 0.5], dim=dim)


@torch.no_grad()
def nearest_turn(found: Tensor, true: Tensor, group: Tensor, loose: Tensor) -> Tensor:
    """The true coordinates after the turn that brings each group of pixels nearest to what was
    found.

    Args:
        found, true: (b, 3, h, w) coordinates.
        group: (b, h, w) int64 numbers of groups from 0, such as instances.
        loose: (b, h, w) bool pixels of objects that may be turned.

    Returns:
        (b, 3, h, w): `true` where `loose` is not.
    """
    groups = int(group.max()) + 1 if group.numel() else 0
    costs = []
    for number in range(TURNS):
        turn = torch.tensor(number, device=true.device)
        apart = smooth_l1_loss(found, turned(true, turn, 1), reduction="none", beta=BEND)
        cost = apart.sum(dim=1).masked_fill(~loose, 0.0).double()
        total = torch.zeros(groups, dtype=cost.dtype, device=cost.device)
        costs.append(total.index_add(0, group.flatten(), cost.flatten()))
    best = torch.stack(costs).argmin(dim=0)[group]
    return torch.where(loose[:, None], turned(true, best, 1), true)
