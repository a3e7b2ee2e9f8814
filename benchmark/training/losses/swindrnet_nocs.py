"""The loss of SwinDRNet's pose network (Dai et al., ECCV 2022), as its program has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy, smooth_l1_loss

from benchmark.pose_methods.swindrnet_nocs.network import SwinNOCSPrediction
from benchmark.training.losses.terms import Loss, mean_where
from benchmark.training.losses.turns import BEND, is_round, nearest_turn

_IDS = 256


class PoseTarget(NamedTuple):
    """What a pose network should have answered.

    Attributes:
        classes: (b, h, w) int64: 0 other, 1 to 7 the classes, 8 background.
        nocs: (b, 3, h, w) normalised coordinates, in [0, 1].
        known: (b, h, w) bool pixels of objects of a class, whose coordinates are known.
        mask: (b, h, w) uint8 instance ids.
    """

    classes: Tensor
    nocs: Tensor
    known: Tensor
    mask: Tensor


@dataclass(frozen=True, kw_only=True)
class SwinNOCSLoss:
    """Cross entropy of the classes, over all pixels, + `coordinates` * (smooth L1 of x, y and z +
    `distance` * root of the mean squared distance), over the pixels of objects of a class.

    Of bottles, bowls and cans the turn of six counts that is nearest to the answer.

    Attributes:
        classes, coordinates, distance: weights; the published ones.
        turns: whether every `instance` is turned for itself, or all of an `image` together, as in
            the authors' program, which two round objects contradict.
    """

    classes: float = 1.0
    coordinates: float = 3.0
    distance: float = 1.0
    turns: Literal["instance", "image"] = "instance"

    def __call__(self, prediction: SwinNOCSPrediction, target: PoseTarget) -> Loss:
        entropy = cross_entropy(prediction.classes, target.classes)
        image = torch.arange(len(target.mask), device=target.mask.device)[:, None, None]
        group = image.expand(target.mask.shape)
        if self.turns == "instance":
            group = group * _IDS + target.mask.long()
        loose = is_round(target.classes) & target.known
        true = nearest_turn(prediction.nocs, target.nocs, group, loose)
        apart = smooth_l1_loss(prediction.nocs, true, reduction="none", beta=BEND).sum(dim=1)
        smooth = mean_where(apart, target.known)
        square = mean_where((prediction.nocs - true).square().sum(dim=1), target.known)
        # The root's gradient is infinite at 0, where a batch without objects is.
        root = square.clamp(min=1e-12).sqrt()
        return Loss(
            self.classes * entropy + self.coordinates * (smooth + self.distance * root),
            {"classes": entropy.detach(), "smooth": smooth.detach(), "distance": root.detach()},
        )
