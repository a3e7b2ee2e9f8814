"""The losses of ClearGrasp's three networks (Sajjan et al., ICRA 2020)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from benchmark.training.losses.outlines import IGNORED, Outlines
from benchmark.training.losses.terms import Loss


class ClearGraspAnswers(NamedTuple):
    """What the networks say, of those that were asked; as in `ClearGraspMaps`."""

    masks: Tensor | None
    normals: Tensor | None
    boundaries: Tensor | None


class ClearGraspTarget(NamedTuple):
    """What they should say.

    Attributes:
        masks: (b, h, w) int64, 1 on the objects whose measurements are to be dropped.
        outlines: normals and boundaries.
    """

    masks: Tensor
    outlines: Outlines


@dataclass(frozen=True, kw_only=True)
class ClearGraspLoss:
    """Cross entropy of masks, 1 - cosine of normals and weighted cross entropy of boundaries.

    The networks share nothing: the sum trains each as its own part alone would.

    Attributes:
        masks, normals, boundaries: weights; a network of weight 0 is not trained.
        boundary: weight of pixels of either kind of boundary, against others; the published one.
        objects: whose measurements are to be dropped. `transparent`, as published; the data sets
            here have specular objects, too.
        gap: metres; neighbours farther apart in depth have an occlusion boundary between them.
        reduce: `mean` over the pixels; or their `sum` over each image, for rates as small as the
            1e-6 of the authors' sample configuration.
    """

    masks: float = 1.0
    normals: float = 1.0
    boundaries: float = 1.0
    boundary: float = 5.0
    objects: Literal["transparent", "specular_transparent"] = "transparent"
    gap: float = 0.01
    reduce: Literal["mean", "sum"] = "mean"

    def __call__(self, answers: ClearGraspAnswers, target: ClearGraspTarget) -> Loss:
        parts: dict[str, Tensor] = {}
        outlines = target.outlines
        if answers.masks is not None:
            parts["masks"] = cross_entropy(answers.masks, target.masks, reduction=self.reduce)
        if answers.normals is not None:
            known = outlines.normals.square().sum(dim=1) > 0.5
            bent = (1 - (answers.normals * outlines.normals).sum(dim=1)).masked_fill(~known, 0.0)
            parts["normals"] = bent.sum()
            if self.reduce == "mean":
                parts["normals"] = bent.sum() / known.sum().clamp(min=1)
        if answers.boundaries is not None:
            parts["boundaries"] = self._of_boundaries(answers.boundaries, outlines.boundaries)
        if self.reduce == "sum":
            parts = {name: part / len(target.masks) for name, part in parts.items()}
        total = torch.stack([getattr(self, name) * part for name, part in parts.items()]).sum()
        return Loss(total, {name: part.detach() for name, part in parts.items()})

    def _of_boundaries(self, answers: Tensor, classes: Tensor) -> Tensor:
        weight = answers.new_tensor((1.0, self.boundary, self.boundary))
        total = cross_entropy(answers, classes, weight, ignore_index=IGNORED, reduction="sum")
        if self.reduce == "sum":
            return total
        known = classes != IGNORED
        return total / (weight[classes.clamp(min=0)] * known).sum().clamp(min=1)
