"""Set abstraction: fewer points, each of which knows its neighbourhood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from benchmark.pointnet.grouping import at, ball_query, group
from benchmark.pointnet.sampling import farthest_points
from benchmark.pointnet.shared_mlp import SharedMLP
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True)
class Scale:
    """A size of neighbourhood.

    Attributes:
        radius: in the unit of the points.
        count: of neighbours.
        widths: channels of the small network over each neighbour.
    """

    radius: float
    count: int
    widths: tuple[int, ...]


class Abstracted(NamedTuple):
    """Fewer points.

    Attributes:
        points: (b, m, 3).
        features: (b, c, m).
        chosen: (b, m) which of the points before they are.
    """

    points: Tensor
    features: Tensor
    chosen: Tensor


class SetAbstraction(nn.Module):
    """Farthest points, a small network over the neighbours of each, and its maximum over them.

    Args:
        centres: how many points are left.
        scales: one, or several whose features are put behind one another.
        inputs: channels of the features; 0 for none.
        normalise: whether relative places are divided by the radius.
        normalised: whether the small networks have batch normalisation.

    Raises:
        ToolkitError: no scale.
    """

    def __init__(
        self,
        centres: int,
        scales: Sequence[Scale],
        inputs: int,
        *,
        normalise: bool = False,
        normalised: bool = True,
    ) -> None:
        super().__init__()
        if not scales:
            raise ToolkitError("needs at least one scale", field="scales")
        self.centres, self.scales, self.normalise = centres, tuple(scales), normalise
        self.mlps = nn.ModuleList(
            SharedMLP(3 + inputs, scale.widths, dimensions=2, normalised=normalised)
            for scale in scales
        )
        self.outputs = sum(scale.widths[-1] for scale in scales)

    def forward(
        self, points: Tensor, features: Tensor | None = None, index: Tensor | None = None
    ) -> Abstracted:
        """Points (b, n, 3) with features (b, c, n); `index` (b, m) to choose the centres."""
        if index is None:
            index = farthest_points(points, self.centres)
        centres = at(points.transpose(1, 2), index).transpose(1, 2)
        found = []
        for scale, mlp in zip(self.scales, self.mlps, strict=True):
            neighbours = ball_query(points, centres, scale.radius, scale.count)
            grouped = group(
                points,
                centres,
                features,
                neighbours,
                scale=scale.radius if self.normalise else 1.0,
            )
            found.append(mlp(grouped).amax(dim=3))
        return Abstracted(centres, torch.cat(found, dim=1), index)
