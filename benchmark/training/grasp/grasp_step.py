"""Training step and loss of GraspNet (Fang et al., CVPR 2020)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, huber_loss

from benchmark.methods.grasp.graspnet.cloud import fibonacci_views, gripper_rotations
from benchmark.methods.grasp.graspnet.graspnet_network import Approaches, GraspNetwork, Operations
from benchmark.training.grasp.grasp_labels import UNIT
from benchmark.training.step import Batch, Loss, ModelInput, StepInfo, mean_where

# What widths and tolerances are measured by, metres, so that all parts are of one size.
_WIDTH, _TOLERANCE = 0.1, 0.05

# Too little to put a turn before one that is better by a step.
_NUDGE = 1e-3

_FRICTIONS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2)

# Momentum of batch normalisation: at first, by what it falls how often, and at last.
_MOMENTUM, _FALL, _FALLS, _LAST = 0.5, 0.5, 9, 0.001

# In short trainings it stays so large that a share of the last steps decides, not all of them.
_LOOKS_BACK = 0.05


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
        # which follows from the points between the fingers; the first of them does not.
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


class Known(NamedTuple):
    """What is known of a batch.

    Attributes:
        views: (b, s, v) score of the best grasp of each of the camera's views.
        alike: (O, v) of each object the view of its own that is nearest to each of the camera's.
        table: (R, v, a, d) scores of the rows.
    """

    views: Tensor
    alike: Tensor
    table: Tensor


def grasp_step(network: nn.Module, loss: Any, inputs: ModelInput, step_info: StepInfo) -> Loss:
    """The step of `GraspNetwork`; `inputs.batch` is one of `PackedGrasps`."""
    assert isinstance(network, GraspNetwork)
    if network.training:
        soften_normalisation(network, step_info)
    approaches, operations, target = answers_and_truth(network, inputs.batch)
    with torch.autocast(inputs.batch["cloud"].device.type, enabled=False):
        return loss(
            Approaches(*(part.float() for part in approaches)),
            Operations(*(part.float() for part in operations)),
            target,
        )


def answers_and_truth(
    network: GraspNetwork, batch: Batch
) -> tuple[Approaches, Operations, GraspTarget]:
    """What the network says of a batch, and what it should have said.

    The view of each seed is the one that the network holds for the best, and its grasps are those
    of the nearest view of the object, whose approach the gripper takes. Turns are counted from
    that of them which is nearest to where the camera's view would have them begin: so begins what
    the network is asked for when it plans, and an object's pose makes no difference. (The authors
    count them from where the object's view begins.)
    """
    config = network.config
    order = drawn_points(network, batch)
    cloud = batch["cloud"].gather(1, order[..., None].expand(-1, -1, 3))
    seeds = network.seeds(cloud)
    chosen = order.gather(1, seeds.chosen)
    row, obj = batch["row"].gather(1, chosen), batch["object"].gather(1, chosen)
    known = known_of(batch, row, config.views)
    there = row >= 0
    at = row.clamp(min=0)
    view = seeds.approaches.views.detach().argmax(dim=2)  # of the camera's
    rotations = _rotations(config.views, config.angles, str(cloud.device))
    turned = rotations[view]
    if len(known.table):
        owner = batch["row_object"][at]
        own = known.alike[owner, view]  # of the object's
        begun, turns = begin_of_turns(
            batch["turned"][owner] @ rotations[own], rotations[view], config.angles
        )
        turned = torch.where(there[..., None, None], begun, turned)
        turns = turns[..., None].expand(*turns.shape, len(config.depths))
        scores, widths, tolerances = (
            part[at, own].gather(2, turns)
            for part in (known.table, batch["widths"], batch["tolerances"])
        )
        mask = there[..., None, None]
        scores = torch.where(mask, scores, 0.0)
        widths, tolerances = (torch.where(mask, part * UNIT, 0.0) for part in (widths, tolerances))
    else:
        shape = (*view.shape, config.angles, len(config.depths))
        scores = widths = tolerances = cloud.new_zeros(shape)
    operations = network.operations(cloud, seeds.points, turned)
    # A seed on an object whose grasps are not known was measured where the object is not.
    objectness = torch.where(obj < 0, 0, torch.where(there, 1, -1))
    target = GraspTarget(objectness, there, known.views, scores, widths, tolerances)
    return seeds.approaches, operations, target


def begin_of_turns(own: Tensor, camera: Tensor, angles: int) -> tuple[Tensor, Tensor]:
    """Grippers turned by whole steps about their approach, to be nearest to others.

    Args:
        own: (..., 3, 3) rotations.
        camera: (..., 3, 3) those to be near to, of about the same approach.
        angles: steps in half a turn, after which fingers are swapped and the grasp is the same.

    Returns:
        (..., 3, 3) the turned ones, and (..., angles) int64 which of the turns that were counted
        from `own` is now the first, the second and so on.
    """
    between = own.transpose(-1, -2) @ camera
    step = torch.pi / angles
    first = (torch.atan2(between[..., 2, 1], between[..., 1, 1]) / step).round()
    c, s = (first * step).cos()[..., None], (first * step).sin()[..., None]
    x, y, z = own.unbind(-1)
    turned = torch.stack([x, c * y + s * z, c * z - s * y], dim=-1)
    order = first.long()[..., None] + torch.arange(angles, device=own.device)
    return turned, order % angles


def drawn_points(network: GraspNetwork, batch: Batch) -> Tensor:
    """(b, n) which points of a batch's clouds the network is shown: in training others every time.

    A network that sees the same points again and again learns where they lie, not the surface.
    """
    b, count = batch["cloud"].shape[:2]
    device, wanted = batch["cloud"].device, network.config.points
    if network.training:
        return torch.rand(b, count, device=device).argsort(dim=1)[:, :wanted]
    return torch.arange(wanted, device=device).expand(b, -1)


def known_of(batch: Batch, row: Tensor, views: int) -> Known:
    """What is known of a batch's rows, and of seeds of these rows (b, s)."""
    device = batch["cloud"].device
    table = _scores(str(device))[batch["friction"].long()]
    directions = _views(views, str(device))
    # (O, v, v): of each object its own views, turned to the camera, against the camera's.
    closeness = (directions @ batch["turned"].transpose(1, 2)) @ directions.T
    alike = closeness.argmax(dim=1)
    if not len(table):
        return Known(table.new_zeros(*row.shape, views), alike, table)
    best = table.amax(dim=(2, 3)).gather(1, alike[batch["row_object"]])
    return Known(torch.where((row >= 0)[..., None], best[row.clamp(min=0)], 0.0), alike, table)


def soften_normalisation(network: nn.Module, step_info: StepInfo) -> None:
    """Batch normalisation's momentum falls by halves, as published every second of 18 epochs."""
    falls = int(_FALLS * step_info.step / step_info.steps)
    least = max(_LAST, min(_MOMENTUM, 1 / (_LOOKS_BACK * step_info.steps)))
    momentum = max(_MOMENTUM * _FALL**falls, least)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            module.momentum = momentum


def score_of_friction(friction: float) -> float:
    """What the network predicts of a grasp: the logarithm of how much less friction it needs.

    >>> round(score_of_friction(0.2), 3), score_of_friction(1.2)
    (1.792, 0.0)
    """
    return float(np.log(_FRICTIONS[-1] / friction))


@lru_cache(maxsize=4)
def _scores(device: str) -> Tensor:
    table = [0.0, *(score_of_friction(f) for f in _FRICTIONS)]
    return torch.tensor(table, dtype=torch.float32, device=device)


@lru_cache(maxsize=4)
def _views(count: int, device: str) -> Tensor:
    return torch.from_numpy(fibonacci_views(count)).to(device, torch.float32)


@lru_cache(maxsize=4)
def _rotations(views: int, angles: int, device: str) -> Tensor:
    """(v, 3, 3) before any turn."""
    return torch.from_numpy(gripper_rotations(views, angles)[:, 0]).to(device, torch.float32)
