"""Feature propagation: features of few points back to the many that they were chosen from."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from benchmark.pointnet.grouping import at, nearest
from benchmark.pointnet.shared_mlp import SharedMLP

_NEIGHBOURS = 3
# Squared distance that a place shared with a neighbour counts as.
_LEAST = 1e-8


def interpolated(known: Tensor, features: Tensor, wanted: Tensor) -> Tensor:
    """(b, c, m) features at places between the known ones.

    The mean of the three nearest, weighted by the inverse of the squared distance.

    Args:
        known: (b, n, 3); fewer than three are taken all.
        features: (b, c, n) there.
        wanted: (b, m, 3).
    """
    squared, index = nearest(known, wanted, min(_NEIGHBOURS, known.shape[1]))
    weights = 1 / (squared + _LEAST)
    weights = weights / weights.sum(dim=2, keepdim=True)
    return (at(features, index) * weights[:, None]).sum(dim=3)


class FeaturePropagation(nn.Module):
    """Interpolated features beside those that the points had before, through a small network.

    Args:
        inputs: channels of both together.
        widths: of the small network.
        normalised: whether it has batch normalisation.
    """

    def __init__(self, inputs: int, widths: Sequence[int], *, normalised: bool = True) -> None:
        super().__init__()
        self.mlp = SharedMLP(inputs, widths, normalised=normalised)
        self.outputs = self.mlp.outputs

    def forward(
        self, known: Tensor, features: Tensor, wanted: Tensor, before: Tensor | None = None
    ) -> Tensor:
        """(b, c, m) at `wanted` (b, m, 3), which had features `before` (b, d, m) or none."""
        carried = interpolated(known, features, wanted)
        if before is not None:
            carried = torch.cat([carried, before], dim=1)
        return self.mlp(carried)
