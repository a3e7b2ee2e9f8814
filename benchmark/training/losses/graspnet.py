"""The loss of GraspNet (Fang et al., CVPR 2020)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor
from torch.nn.functional import cross_entropy, huber_loss

from benchmark.grasp_methods.graspnet.heads import Approaches, Operations
from benchmark.training.losses.terms import Loss, mean_where

# What widths and tolerances are measured by, metres, so that all parts are of one size.
_WIDTH, _TOLERANCE = 0.1, 0.05
# Too little to put a turn before one that is better by a step.
_NUDGE = 1e-3


class GraspTarget(NamedTuple):
    """What the network should have answered about s seeds.

    Attributes:
        objectness: (b, s) int64: 1 on an object, 0 elsewhere, -1 where nobody knows.
        known: (b, s) bool, whether the seed's grasps are known.
        views: (b, s, v) score of the best grasp of each view, 0 for none.
        scores: (b, s, a, d) of the grasps of the chosen view by turn and depth, 0 for no grasp.
        widths, tolerances: (b, s, a, d) metres.
    """

    objectness: Tensor
    known: Tensor
    views: Tensor
    scores: Tensor
    widths: Tensor
    tolerances: Tensor


@dataclass(frozen=True, kw_only=True)
class GraspNetLoss:
    """Is there an object; how good each view is; and of the chosen view at each depth, which turn
    is best, and that turn's score, width and tolerance.

    Attributes:
        views: weight of the views' squared error.
        operation: weight of what is said of the chosen view.
        least: score above which the best grasp of a view and depth must lie to count there.
    """

    views: float = 1.0
    operation: float = 0.2
    least: float = 0.1

    def __call__(self, approaches: Approaches, operations: Operations, target: GraspTarget) -> Loss:
        """The loss of what was said of the seeds, and of a view of each."""
        settled = (target.objectness >= 0).sum().clamp(min=1)
        objectness = cross_entropy(
            approaches.objectness, target.objectness, ignore_index=-1, reduction="sum"
        )
        parts = {"objectness": objectness / settled}
        error = (approaches.views - target.views).square().mean(dim=2)
        parts["views"] = mean_where(error, target.known)

        best = target.scores.amax(dim=2)  # (b, s, d)
        # Scores come in six steps. Of turns that are equally good the one amid others is meant,
        # which can be told from what lies between the fingers; the first of them cannot.
        beside = target.scores.roll(1, dims=2) + target.scores.roll(-1, dims=2)
        turn = (target.scores + _NUDGE * beside).argmax(dim=2)
        counts = (best > self.least) & target.known[..., None]
        at = turn[:, :, None]

        def apart(found: Tensor, true: Tensor, unit: float) -> Tensor:
            found, true = found.gather(2, at)[:, :, 0], true.gather(2, at)[:, :, 0]
            return mean_where(huber_loss(found / unit, true / unit, reduction="none"), counts)

        parts["score"] = apart(operations.scores, target.scores, 1.0)
        turns = cross_entropy(operations.turns.transpose(1, 2), turn, reduction="none")
        parts["turn"] = mean_where(turns, counts)
        parts["width"] = apart(operations.widths, target.widths, _WIDTH)
        parts["tolerance"] = apart(operations.tolerances, target.tolerances, _TOLERANCE)
        of_view = parts["score"] + parts["turn"] + parts["width"] + parts["tolerance"]
        total = parts["objectness"] + self.views * parts["views"] + self.operation * of_view
        return Loss(total, {name: part.detach() for name, part in parts.items()})
