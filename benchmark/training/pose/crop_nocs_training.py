"""Training of crop NOCS: augmented crops of all objects of a frame, and their loss."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import log_softmax

from benchmark.methods.pose.crop_nocs import BinnedCoordinates
from benchmark.methods.pose.segmented import Placed, longest_axis
from benchmark.training.pose import deformation_loss
from benchmark.training.pose.deformation_training import loss_of_objects, trained_depth
from benchmark.training.step import Loss, ModelInput, StepInfo

# Of the greatest coordinate that is seen along an axis: some of an object is hidden, so its half
# side is rather larger.
_QUANTILE = 0.65

_MARGINS = (0.95, 1.35)
_SHIFT = 0.06


@dataclass(frozen=True, kw_only=True)
class CropNOCSLoss:
    """Cross entropy of the bins and error of the box.

    Attributes:
        bins: weight of the mean cross entropy of x, y and z. A coordinate between the middles of
            two bins belongs to both in part.
        box: weight of the error of the half sides, as a quantile of what is seen (of the whole
            object, frames tell no more).
        turn: largest turn of a crop beside the one that aligns it, degrees either way. Half of
            the crops are upside down.
    """

    bins: float = 1.0
    box: float = 2.0
    turn: float = 20.0

    def __call__(self, answer: BinnedCoordinates, truth: deformation_loss.ObjectTruth) -> Loss:
        truth = deformation_loss.facing(truth)
        bins = binned_entropy(answer.logits, truth.coordinates, truth.known).mean()
        short = seen_half(truth) - answer.half
        box = torch.maximum(_QUANTILE * short, (_QUANTILE - 1) * short).sum(dim=1).mean()
        parts = {"bins": self.bins * bins, "box": self.box * box}
        return Loss(
            torch.stack(list(parts.values())).sum(), {n: p.detach() for n, p in parts.items()}
        )


def binned_entropy(logits: Tensor, true: Tensor, known: Tensor) -> Tensor:
    """(b,) mean cross entropy over the known points.

    Args:
        logits: (b, 3, bins, n).
        true: (b, n, 3) coordinates, the middle at 0.
        known: (b, n) bool.
    """
    count = logits.shape[2]
    place = ((true.transpose(1, 2) + 0.5) * count - 0.5).clamp(0, count - 1)
    low = place.floor().clamp(max=count - 2).long()
    upper = (place - low)[:, :, None]
    chances = log_softmax(logits, dim=2)
    below = chances.gather(2, low[:, :, None])
    above = chances.gather(2, low[:, :, None] + 1)
    entropy = -((1 - upper) * below + upper * above)[:, :, 0].mean(dim=1)
    return entropy.masked_fill(~known, 0.0).sum(dim=1) / known.sum(dim=1).clamp(min=1)


def seen_half(truth: deformation_loss.ObjectTruth) -> Tensor:
    """(b, 3) how far seen points reach from the middle; round objects as far along x as along z."""
    far = truth.coordinates.abs().masked_fill(~truth.known[..., None], 0.0)
    half = far.amax(dim=1)
    radius = far[..., ::2].norm(dim=2).amax(dim=1)
    round_half = torch.stack([radius, half[:, 1], radius], dim=1)
    return torch.where(truth.turned[:, None], round_half, half)


def crop_nocs_step(
    network: nn.Module,
    loss: Any,
    inputs: ModelInput,
    step_info: StepInfo,  # noqa: ARG001
) -> Loss:
    """All objects of each frame, their crops turned, moved and scaled at random."""
    config: Any = network.config
    found = deformation_loss.objects_of(
        inputs.color,
        trained_depth(config, inputs, drawn=True),
        inputs.batch,
        categories=len(config.categories),
        side=config.side,
        points=config.points,
        one_each=False,
        placed=lambda mask: _placed(mask, loss.turn),
        masked=True,
    )
    return loss_of_objects(network, loss, inputs, found)


def _placed(mask: Tensor, turn: float) -> Placed:
    draw = torch.rand(5).tolist()
    low, high = _MARGINS
    angle = longest_axis(mask) + math.radians(turn) * (2 * draw[0] - 1)
    return Placed(
        angle + math.pi * round(draw[4]),
        low + (high - low) * draw[1],
        (_SHIFT * (2 * draw[2] - 1), _SHIFT * (2 * draw[3] - 1)),
    )
