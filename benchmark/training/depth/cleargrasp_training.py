"""How ClearGrasp's networks are trained and judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
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
from benchmark.training.config import seed_of
from benchmark.training.depth.cleargrasp_losses import (
    CONTACT,
    NONE,
    OCCLUSION,
    ClearGraspAnswers,
    ClearGraspLoss,
    ClearGraspTarget,
    outlines_of,
)
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.step import Batch, Loss, ModelInput, StepInfo, made_of, network_inputs
from benchmark.training.validation import batches, evaluating, shown_of
from std_toolkit.io.images import write_color

_NETWORKS = ("masks", "normals", "boundaries")


def cleargrasp_step(
    network: nn.Module,
    loss: Any,
    seen: ModelInput,
    step_info: StepInfo,  # noqa: ARG001
) -> Loss:
    """All networks learn whose loss has a weight."""
    answers = _answers(cast(ClearGraspNetwork, network), loss, seen.color)
    with torch.autocast(seen.color.device.type, enabled=False):
        return loss(answers, cleargrasp_target(seen.batch, loss))


def cleargrasp_target(batch: Batch, loss: ClearGraspLoss) -> ClearGraspTarget:
    """What the networks should say of a batch."""
    dropped: tuple[Material, ...] = (Material.TRANSPARENT,)
    if loss.objects == "specular_transparent":
        dropped = (Material.TRANSPARENT, Material.SPECULAR)
    outlines = outlines_of(batch["true"][:, None], batch["mask"], batch["K"], loss.gap)
    return ClearGraspTarget(made_of(batch, *dropped).long(), outlines)


class ClearGraspValidator:
    """Masks and boundaries by their overlap, normals by their angle; ranked by the loss.

    Args: as of `Judge`.
    """

    # Sums of a state: pixels of both and of either for masks, occlusion boundaries and contact
    # edges; degrees and pixels of normals; losses of the frames, and frames.
    def __init__(
        self, frames: PackedFrames, chosen: Sequence[int], batch: int, loss: ClearGraspLoss
    ) -> None:
        self.frames, self.chosen, self.batch, self.loss = frames, tuple(chosen), batch, loss

    @torch.no_grad()
    def states(
        self,
        network: nn.Module,
        device: torch.device,
        *,
        rank: int = 0,
        world: int = 1,
        context: Callable[[], AbstractContextManager[Any]] = nullcontext,
    ) -> np.ndarray:
        total = np.zeros(10)
        with evaluating(network):
            for batch in batches(self.frames, self.chosen[rank::world], self.batch, device):
                with context():
                    color = network_inputs(batch)[0]
                    answers = _answers(cast(ClearGraspNetwork, network), self.loss, color)
                target = cleargrasp_target(batch, self.loss)
                loss = float(self.loss(answers, target).total)
                count = len(color)
                total += [*_sums(answers, target), loss * count, count]
        return total

    def scores(self, states: np.ndarray) -> dict[str, float]:
        over = [a / b if b else float("nan") for a, b in states.reshape(-1, 2)]
        names = ("masks_iou", "occlusion_iou", "contact_iou", "normals_degrees", "loss")
        return {name: float(value) for name, value in zip(names, over, strict=True)}

    def main_score(self, scores: dict[str, float]) -> tuple[str, float]:
        return "loss", scores["loss"]

    def gallery(self, network: nn.Module, device: torch.device, path: Path) -> None:
        """As of `Judge`: the depth that the global optimisation makes of the maps."""
        own, shown = cast(ClearGraspNetwork, network), shown_of(self.chosen)
        color = network_inputs(self.frames[shown])[0].to(device)
        with evaluating(network), torch.no_grad():
            maps = own(color)
        told = own.config.mask == "given"
        frames = [self.frames.frame(i) for i in shown]
        views = [view_of(frame, None, with_mask=told) for frame in frames]
        found = DepthOfMaps(own.config)(maps, views)
        rows = [strip(frame, depth) for frame, depth in zip(frames, found, strict=True)]
        write_color(path, np.vstack(rows), quality=88)


def _answers(network: ClearGraspNetwork, loss: ClearGraspLoss, color: Tensor) -> ClearGraspAnswers:
    seed, asked = torch.initial_seed(), dict.fromkeys(_NETWORKS)
    for place, name in enumerate(_NETWORKS):
        if not getattr(loss, name):
            continue
        if network.training:
            # So that a network drops out the same whether others are trained with it or not.
            torch.manual_seed(seed_of(seed, place))
        asked[name] = network.get_submodule(name)(color).float()
    if asked["normals"] is not None:
        asked["normals"] = normalize(asked["normals"], dim=1)
    return ClearGraspAnswers(**asked)


def _sums(answers: ClearGraspAnswers, target: ClearGraspTarget) -> list[float]:
    """The first eight sums of a state."""
    outlines, sums = target.outlines, [0.0] * 8
    known = outlines.boundaries >= NONE
    if answers.masks is not None:
        sums[0:2] = _overlap(answers.masks.argmax(dim=1) == 1, target.masks == 1)
    if answers.boundaries is not None:
        said = answers.boundaries.argmax(dim=1)
        for place, kind in ((2, OCCLUSION), (4, CONTACT)):
            sums[place : place + 2] = _overlap((said == kind) & known, outlines.boundaries == kind)
    if answers.normals is not None:
        there = outlines.normals.square().sum(dim=1) > 0.5
        cosine = (answers.normals * outlines.normals).sum(dim=1)[there].clamp(-1, 1)
        sums[6:8] = [float(cosine.acos().rad2deg().double().sum()), float(there.sum())]
    return sums


def _overlap(said: Tensor, true: Tensor) -> list[float]:
    return [float((said & true).sum()), float((said | true).sum())]
