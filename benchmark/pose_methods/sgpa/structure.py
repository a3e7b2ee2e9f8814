"""Points that stand for the structure of an object, and the adaptation of a prior by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from benchmark.pointnet import SharedMLP


class Structure(NamedTuple):
    """An object's structure.

    Attributes:
        points: (b, k, 3), each a weighted mean of the object's points.
        geometry, color: (b, k, c) features, means with the same weights.
    """

    points: Tensor
    geometry: Tensor
    color: Tensor


class StructurePoints(nn.Module):
    """Chooses points softly: weights over an object's points, learned from their features.

    Args:
        geometry, color: channels of the features.
        widths: of the network that gives the weights.
        count: of points.
    """

    def __init__(self, geometry: int, color: int, widths: Sequence[int], count: int) -> None:
        super().__init__()
        self.weigh = SharedMLP(
            geometry + color, (*widths, count), normalised=False, last_linear=True
        )

    def forward(self, points: Tensor, geometry: Tensor, color: Tensor) -> Structure:
        """Points (b, n, 3) with features (b, c, n)."""
        scores = self.weigh(torch.cat([geometry, color], dim=1))
        weights = scores.float().softmax(dim=2)
        with torch.autocast(points.device.type, enabled=False):
            return Structure(
                weights @ points,
                weights @ geometry.float().transpose(1, 2),
                weights @ color.float().transpose(1, 2),
            )


class Adaptation(nn.Module):
    """A transformer's attention from a prior's points to the structure of the object.

    Where a part of the prior looks like a part of the object by geometry, it takes the colour
    features of that part.

    Args:
        channels: of all features.
        heads: of the attention.
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.attention = nn.MultiheadAttention(channels, heads, batch_first=True)

    def forward(self, prior: Tensor, structure: Structure) -> Tensor:
        """(b, 2c, m) of prior features (b, c, m): their own, and the attended colour."""
        asked = prior.transpose(1, 2)
        color, _ = self.attention(asked, structure.geometry, structure.color, need_weights=False)
        return torch.cat([prior, color.transpose(1, 2)], dim=1)
