"""Training and validation of ClearGrasp's networks."""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

from benchmark.data.frame import Material
from benchmark.evaluation.depth_panels import strip
from benchmark.methods.depth.cleargrasp.cleargrasp import DepthOfMaps
from benchmark.methods.depth.cleargrasp.cleargrasp_network import ClearGraspNetwork
from benchmark.methods.depth.full_size import view_of
from benchmark.training import config, step, validation
from benchmark.training.depth import cleargrasp_losses

_NETWORKS = ("masks", "normals", "boundaries")


def cleargrasp_step(
    network: nn.Module,
    loss: Any,
    inputs: step.ModelInput,
    step_info: step.StepInfo,  # noqa: ARG001
) -> step.Loss:
    """All networks learn whose loss has a weight."""
    answers = _answers(cast(ClearGraspNetwork, network), loss, inputs.color)
    with torch.autocast(inputs.color.device.type, enabled=False):
        return loss(answers, cleargrasp_target(inputs.batch, loss))


def cleargrasp_target(
    batch: step.Batch, loss: cleargrasp_losses.ClearGraspLoss
) -> cleargrasp_losses.ClearGraspTarget:
    """What the networks should say of a batch."""
    dropped: tuple[Material, ...] = (Material.TRANSPARENT,)
    if loss.objects == "specular_transparent":
        dropped = (Material.TRANSPARENT, Material.SPECULAR)
    outlines = cleargrasp_losses.outlines_of(
        batch["true"][:, None], batch["mask"], batch["K"], loss.gap
    )
    return cleargrasp_losses.ClearGraspTarget(step.made_of(batch, *dropped).long(), outlines)


class ClearGraspValidator(validation.Validator):
    """Masks and boundaries by their overlap, normals by their angle; ranked by the loss.

    The sums are pixels of both and of either for masks, occlusion boundaries and contact edges;
    degrees and pixels of normals; losses of the frames, and frames.
    """

    def zeros(self, network: nn.Module) -> np.ndarray:  # noqa: ARG002
        return np.zeros(10)

    def add(
        self, total: np.ndarray, network: nn.Module, batch: step.Batch, context: validation.Context
    ) -> None:
        color = step.network_inputs(batch)[0]
        with context():
            answers = _answers(cast(ClearGraspNetwork, network), self.loss, color)
        target = cleargrasp_target(batch, self.loss)
        loss = float(self.loss(answers, target).total)
        total += [*_sums(answers, target), loss * len(color), len(color)]

    def scores(self, states: np.ndarray) -> dict[str, float]:
        over = [a / b if b else float("nan") for a, b in states.reshape(-1, 2)]
        names = ("masks_iou", "occlusion_iou", "contact_iou", "normals_degrees", "loss")
        return {name: float(value) for name, value in zip(names, over, strict=True)}

    def main_score(self, scores: dict[str, float]) -> tuple[str, float]:
        return "loss", scores["loss"]

    def pictures(
        self, network: nn.Module, shown: Sequence[int], batch: step.Batch
    ) -> Sequence[np.ndarray]:
        """The depth that the global optimisation makes of the maps."""
        own = cast(ClearGraspNetwork, network)
        maps = own(step.network_inputs(batch)[0])
        frames = [self.frames.frame(i) for i in shown]
        with_mask = own.config.mask == "given"
        views = [view_of(frame, None, with_mask=with_mask) for frame in frames]
        found = DepthOfMaps(own.config)(maps, views)
        return [strip(frame, depth) for frame, depth in zip(frames, found, strict=True)]


def _answers(
    network: ClearGraspNetwork, loss: cleargrasp_losses.ClearGraspLoss, color: Tensor
) -> cleargrasp_losses.ClearGraspAnswers:
    seed, asked = torch.initial_seed(), dict.fromkeys(_NETWORKS)
    for place, name in enumerate(_NETWORKS):
        if not getattr(loss, name):
            continue
        if network.training:
            # So that a network drops out the same whether others are trained with it or not.
            torch.manual_seed(config.seed_of(seed, place))
        asked[name] = network.get_submodule(name)(color).float()
    if asked["normals"] is not None:
        asked["normals"] = normalize(asked["normals"], dim=1)
    return cleargrasp_losses.ClearGraspAnswers(**asked)


def _sums(
    answers: cleargrasp_losses.ClearGraspAnswers, target: cleargrasp_losses.ClearGraspTarget
) -> list[float]:
    """The first eight sums of a state."""
    outlines, sums = target.outlines, [0.0] * 8
    known = outlines.boundaries >= cleargrasp_losses.NONE
    if answers.masks is not None:
        sums[0:2] = _overlap(answers.masks.argmax(dim=1) == 1, target.masks == 1)
    if answers.boundaries is not None:
        said = answers.boundaries.argmax(dim=1)
        for place, kind in ((2, cleargrasp_losses.OCCLUSION), (4, cleargrasp_losses.CONTACT)):
            sums[place : place + 2] = _overlap((said == kind) & known, outlines.boundaries == kind)
    if answers.normals is not None:
        there = outlines.normals.square().sum(dim=1) > 0.5
        cosine = (answers.normals * outlines.normals).sum(dim=1)[there].clamp(-1, 1)
        sums[6:8] = [float(cosine.acos().rad2deg().double().sum()), float(there.sum())]
    return sums


def _overlap(said: Tensor, true: Tensor) -> list[float]:
    return [float((said & true).sum()), float((said | true).sum())]
