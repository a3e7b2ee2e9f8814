"""The loss of NLSPN (Park et al., ECCV 2020)."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from benchmark.methods.network import Prediction
from benchmark.training.losses.terms import Loss, Target, weighed, weighed_mean

_KNOWN = 1e-4  # metres; less is no ground truth


@dataclass(frozen=True, kw_only=True)
class NLSPNLoss:
    """Absolute and squared error of the final depth alone: means over each image's pixels with
    ground truth, then over the batch.

    Attributes:
        absolute, squared: weights; the published ones.
        objects: how many times as much as others pixels of objects count, as published 1.
        farthest: metres; truth and prediction are limited to [0, farthest], as in the authors'
            program (10 m indoors). A prediction outside receives no gradient. None for no limit,
            which is what the paper's formula says; the truth of the data sets here is below 10 m
            either way.
    """

    absolute: float = 1.0
    squared: float = 1.0
    objects: float = 1.0
    farthest: float | None = 10.0

    def __call__(self, prediction: Prediction, target: Target) -> Loss:
        depth, true = prediction.depth, target.depth
        known = true > _KNOWN
        if self.farthest is not None:
            depth, true = depth.clamp(0, self.farthest), true.clamp(0, self.farthest)
        error = (depth - true).masked_fill(~known, 0.0)
        weights = weighed(target, self.objects) * known
        absolute, squared = _by_image(error.abs(), weights), _by_image(error.square(), weights)
        return Loss(
            self.absolute * absolute + self.squared * squared,
            {"absolute": absolute.detach(), "squared": squared.detach()},
        )


def _by_image(values: Tensor, weights: Tensor) -> Tensor:
    return weighed_mean(values, weights, dim=(1, 2, 3)).mean()
