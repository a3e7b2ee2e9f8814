"""The loss of DFNet (Fang et al., RA-L 2022)."""

from __future__ import annotations

from dataclasses import dataclass

from benchmark.methods.network import Prediction
from benchmark.training.losses.surfaces import normals, whole_around
from benchmark.training.losses.terms import Loss, Target, mean_where, weighed, weighed_mean


@dataclass(frozen=True, kw_only=True)
class DFNetLoss:
    """Squared error + `smoothness` * (1 - cosine between the normals), over the pixels whose true
    depth is in range.

    Attributes:
        smoothness: weight; the published one.
        near, far: metres, the range of the published network.
        foreground_only: compare only pixels of objects. The paper compares all.
        objects: how many times as much as others pixels of objects count in the squared error, as
            published 1.
    """

    smoothness: float = 0.001
    near: float = 0.3
    far: float = 1.5
    foreground_only: bool = False
    objects: float = 1.0

    def __call__(self, prediction: Prediction, target: Target) -> Loss:
        true = target.depth
        known = (true >= self.near) & (true <= self.far)
        compared = known & target.foreground if self.foreground_only else known
        error = (prediction.depth - true).masked_fill(~compared, 0.0)
        squared = weighed_mean(error.square(), weighed(target, self.objects) * compared)
        both = normals(prediction.depth, target.K) * normals(true, target.K)
        bent = mean_where(1 - both.sum(dim=1, keepdim=True), compared & whole_around(known))
        return Loss(
            squared + self.smoothness * bent,
            {"squared": squared.detach(), "bent": bent.detach()},
        )
