"""PointNet++ layers: shared MLP, set abstraction, feature propagation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from benchmark.methods.pointnet.grouping import at, ball_query, farthest_points, group, nearest
from std_toolkit.errors import ToolkitError

_NEIGHBOURS = 3

# Squared distance that a place shared with a neighbour counts as.
_LEAST = 1e-8


class SharedMLP(nn.Sequential):
    """1x1 convolutions, each with batch normalisation and ReLU.

    Args:
        inputs: channels.
        widths: channels after each convolution.
        dimensions: 1 for (b, c, n), 2 for (b, c, m, k).
        normalised: whether there is batch normalisation; without, convolutions have a bias.
        last_linear: whether the last convolution stands alone, without either.
    """

    def __init__(
        self,
        inputs: int,
        widths: Sequence[int],
        *,
        dimensions: int = 1,
        normalised: bool = True,
        last_linear: bool = False,
    ) -> None:
        convolution: type[nn.Conv1d] | type[nn.Conv2d]
        normalisation: type[nn.BatchNorm1d] | type[nn.BatchNorm2d]
        convolution, normalisation = (
            (nn.Conv1d, nn.BatchNorm1d) if dimensions == 1 else (nn.Conv2d, nn.BatchNorm2d)
        )
        layers: list[nn.Module] = []
        for place, width in enumerate(widths):
            alone = last_linear and place == len(widths) - 1
            layers.append(convolution(inputs, width, 1, bias=alone or not normalised))
            if not alone:
                layers += [normalisation(width)] if normalised else []
                layers.append(nn.ReLU())
            inputs = width
        super().__init__(*layers)
        self.outputs = inputs


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
    ) -> None:
        super().__init__()
        if not scales:
            raise ToolkitError("needs at least one scale", field="scales")
        self.centres, self.scales, self.normalise = centres, tuple(scales), normalise
        self.mlps = nn.ModuleList(
            SharedMLP(3 + inputs, scale.widths, dimensions=2) for scale in scales
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


def interpolated(
    known: Tensor, features: Tensor, wanted: Tensor, *, squared_weights: bool = True
) -> Tensor:
    """(b, c, m) features at places between the known ones.

    The mean of the three nearest, weighted by the inverse of the squared distance, or by the
    inverse of the distance as in SGPA's program.

    Args:
        known: (b, n, 3); fewer than three are taken all.
        features: (b, c, n) there.
        wanted: (b, m, 3).
    """
    squared, index = nearest(known, wanted, min(_NEIGHBOURS, known.shape[1]))
    weights = 1 / ((squared if squared_weights else squared.sqrt()) + _LEAST)
    weights = weights / weights.sum(dim=2, keepdim=True)
    return (at(features, index) * weights[:, None]).sum(dim=3)


class FeaturePropagation(nn.Module):
    """Interpolated features beside those that the points had before, through a small network.

    Args:
        inputs: channels of both together.
        widths: of the small network.
        squared_weights: see `interpolated`.
    """

    def __init__(
        self,
        inputs: int,
        widths: Sequence[int],
        *,
        squared_weights: bool = True,
    ) -> None:
        super().__init__()
        self.squared_weights = squared_weights
        self.mlp = SharedMLP(inputs, widths)
        self.outputs = self.mlp.outputs

    def forward(
        self, known: Tensor, features: Tensor, wanted: Tensor, before: Tensor | None = None
    ) -> Tensor:
        """(b, c, m) at `wanted` (b, m, 3), which had features `before` (b, d, m) or none."""
        carried = interpolated(known, features, wanted, squared_weights=self.squared_weights)
        if before is not None:
            carried = torch.cat([carried, before], dim=1)
        return self.mlp(carried)
