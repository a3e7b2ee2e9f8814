"""Deformation of a shape prior: output, and heads by category."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from benchmark.methods.pointnet.layers import SharedMLP


class Deformed(NamedTuple):
    """What a network says of a batch of objects.

    Attributes:
        assignment: (b, n, m) how much each point of the object is each point of the prior; rows add
            to 1.
        deformation: (b, m, 3) what is added to the prior.
        shape: (b, m, 3) the object as the deformed prior, normalised, the middle at 0.
        coordinates: (b, n, 3) normalised coordinates of the object's points, the middle at 0.
        points: (b, n, 3) the points that were given, as the network sees them.
        structure: (b, k, 3) points that stand for the object's structure; None of networks that
            have none.
    """

    assignment: Tensor
    deformation: Tensor
    shape: Tensor
    coordinates: Tensor
    points: Tensor
    structure: Tensor | None = None


class PerCategory(nn.Module):
    """The last convolution of a head, with weights of its own for each category.

    Only those of an object's category are used, instead of answering for all and choosing after.

    Args:
        inputs, outputs: channels.
        categories: how many.
    """

    def __init__(self, inputs: int, outputs: int, categories: int) -> None:
        super().__init__()
        first = [nn.Conv1d(inputs, outputs, 1) for _ in range(categories)]
        self.weight = nn.Parameter(torch.stack([c.weight.detach()[..., 0] for c in first]))
        self.bias = nn.Parameter(torch.stack([c.bias.detach() for c in first]))  # type: ignore[union-attr]

    def forward(self, features: Tensor, category: Tensor) -> Tensor:
        """(b, outputs, n) of features (b, inputs, n) and categories (b,)."""
        return self.weight[category] @ features + self.bias[category][..., None]


class Head(nn.Module):
    """A small network over each point with a last layer by category."""

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int, categories: int) -> None:
        super().__init__()
        self.trunk = SharedMLP(inputs, hidden, normalised=False)
        self.last = PerCategory(self.trunk.outputs, outputs, categories)

    def forward(self, features: Tensor, category: Tensor) -> Tensor:
        return self.last(self.trunk(features), category)


class Deformer(nn.Module):
    """Features of an object and of its prior to an assignment and a deformation, as in SPD.

    Args:
        local: channels of the object's points.
        prior_local: channels of the prior's points.
        width: channels of the features of the whole object and of the whole prior.
        hidden: widths of the heads.
        categories: how many.
        prior_points: of a prior.
        prior_hidden: channels before those of the whole prior; those of its points by default.
    """

    def __init__(
        self,
        local: int,
        prior_local: int,
        *,
        width: int,
        hidden: Sequence[int],
        categories: int,
        prior_points: int,
        prior_hidden: int | None = None,
    ) -> None:
        super().__init__()
        self.whole = SharedMLP(local, (local, width), normalised=False)
        inner = prior_hidden or prior_local
        self.prior_whole = SharedMLP(prior_local, (inner, width), normalised=False)
        self.assign = Head(local + 2 * width, hidden, prior_points, categories)
        self.deform = Head(prior_local + 2 * width, hidden, 3, categories)
        # A deformation that begins small: the prior is the best that is known at first.
        nn.init.normal_(self.deform.last.weight, std=1e-4)
        nn.init.zeros_(self.deform.last.bias)

    def forward(
        self,
        local: Tensor,
        prior_local: Tensor,
        prior: Tensor,
        points: Tensor,
        category: Tensor,
        structure: Tensor | None = None,
    ) -> Deformed:
        """Features (b, c, n) of points (b, n, 3), and (b, d, m) of a prior (b, m, 3)."""
        n, m = local.shape[2], prior_local.shape[2]
        whole = self.whole(local).mean(dim=2, keepdim=True)
        prior_whole = self.prior_whole(prior_local).mean(dim=2, keepdim=True)
        both = torch.cat([whole, prior_whole], dim=1)
        scores = self.assign(torch.cat([local, both.expand(-1, -1, n)], dim=1), category)
        # Numbers of half precision would not add to 1 over a thousand points.
        assignment = scores.float().transpose(1, 2).softmax(dim=2)
        moved = self.deform(torch.cat([prior_local, both.expand(-1, -1, m)], dim=1), category)
        deformation = moved.float().transpose(1, 2)
        shape = prior + deformation
        with torch.autocast(points.device.type, enabled=False):
            coordinates = assignment @ shape
        return Deformed(assignment, deformation, shape, coordinates, points, structure)
