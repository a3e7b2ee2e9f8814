"""Training of LIDF (Zhu et al., CVPR 2021): losses of both stages, batches, phases."""

import math
from dataclasses import dataclass
from typing import Any, Literal, cast

import torch
from torch import Tensor, nn

from benchmark.data.frame import Material
from benchmark.methods.depth.lidf.lidf import LIDFNetwork, LIDFPrediction
from benchmark.methods.depth.lidf.voxels import Terminations, true_pairs
from benchmark.methods.torch_camera import points_of
from benchmark.training import step
from benchmark.training.depth.depth_losses import normals

COARSE, REFINE, HARD = "coarse", "refine", "hard"  # phases of the training


@dataclass(frozen=True, kw_only=True)
class LIDFLoss:
    """Positions, ends of rays and normals of the first stage; positions and normals of the second.

    A position's part is the mean of |x|, |y| and |z| of the difference, over the pixels that were
    predicted and whose truth is known; a normal's (1 - cosine) / 2, over those whose right and
    lower neighbours are so, too; a ray's the cross entropy of the voxel that it ends in, over the
    rays that end in one of their voxels.

    Attributes:
        positions, terminations, normals: weights; the published ones.
        hard_positions, hard_normals: weights in the last phase.
        hard_share: in which only this share of the pixels counts, those farthest from the truth.
        told: share of the first phase in which rays are taken to end in the voxel where they truly
            do, not in the likeliest: the published 6 epochs of 60.
    """

    positions: float = 100.0
    terminations: float = 0.5
    normals: float = 10.0
    hard_positions: float = 20.0
    hard_normals: float = 2.0
    hard_share: float = 0.1
    told: float = 0.1

    def __call__(self, prediction: LIDFPrediction, target: step.Target, phase: str) -> step.Loss:
        depth = prediction.depth.to(target.depth.dtype)
        rays = points_of(torch.ones_like(target.depth), target.K)
        reach = rays.abs().mean(dim=1, keepdim=True)
        apart = (depth - target.depth).abs() * reach
        known = predicted(prediction) & (target.depth > 0)
        counts = known
        if phase == HARD:
            counts = known & hardest(apart.detach(), known, self.hard_share)
        distance = step.mean_where(apart, counts)
        bent = (1 - (normals(depth, target.K) * normals(target.depth, target.K)).sum(1)) / 2
        bend = step.mean_where(bent[:, None], counts & with_neighbours(known))
        parts = {"positions": distance.detach(), "normals": bend.detach()}
        if phase == HARD:
            return step.Loss(self.hard_positions * distance + self.hard_normals * bend, parts)
        total = self.positions * distance + self.normals * bend
        if prediction.terminations is not None:
            ends = end_loss(prediction.terminations, target.depth)
            total = total + self.terminations * ends
            parts["terminations"] = ends.detach()
        return step.Loss(total, parts)


def end_loss(terminations: Terminations, true: Tensor) -> Tensor:
    """Mean of -log of the chance of the voxel that holds (b, 1, h, w) the true depth."""
    distance = true.flatten()[terminations.rays.pixel] / terminations.rays.direction[:, 2]
    ends = true_pairs(terminations.pairs, distance)
    found = terminations.log_probability[ends[ends >= 0]]
    return -found.sum() / max(len(found), 1)


def predicted(prediction: LIDFPrediction) -> Tensor:
    """(b, 1, h, w) bool pixels whose depth the learning stage predicted."""
    terminations = prediction.terminations
    if terminations is not None:
        pixels = terminations.rays.pixel[terminations.chosen >= 0]
    else:
        assert prediction.refinements is not None
        pixels = prediction.refinements.rays.pixel
    found = torch.zeros_like(prediction.depth, dtype=torch.bool).flatten()
    return found.index_fill(0, pixels, True).reshape(prediction.depth.shape)


def hardest(apart: Tensor, known: Tensor, share: float) -> Tensor:
    """Bool pixels: a share of the known ones, those of the largest `apart`."""
    values = apart[known]
    if not len(values):
        return known
    count = max(1, math.ceil(share * len(values)))
    return known & (apart >= values.topk(count).values[-1])


def with_neighbours(known: Tensor) -> Tensor:
    """(b, 1, h, w) bool: known pixels whose right and lower neighbours are known."""
    found = torch.zeros_like(known)
    inside = known[..., :-1, :-1] & known[..., :-1, 1:] & known[..., 1:, :-1]
    found[..., :-1, :-1] = inside
    return found


def lidf_inputs(network: LIDFNetwork, inputs: step.ModelInput) -> tuple[Tensor, ...]:
    """Colour, depth, rays, which depth is believed and which pixels are asked for, as the restorer
    gives them to the network."""
    color, depth, batch = inputs
    rays = points_of(torch.ones_like(depth), batch["K"])
    believed = depth > 0
    if network.config.mask == "objects":
        believed &= ~step.made_of(batch, Material.TRANSPARENT, Material.SPECULAR)[:, None]
    asked = torch.ones_like(believed) if network.config.predict == "all" else ~believed
    return color, depth, rays, believed, asked


def lidf_step(
    network: nn.Module, loss: Any, inputs: step.ModelInput, step_info: step.StepInfo
) -> step.Loss:
    """Train the first stage in the phase `coarse`, at its beginning with the true voxels, and the
    second stage in the other phases."""
    own, loss = cast(LIDFNetwork, network), cast(LIDFLoss, loss)
    stage: Literal[1, 2] = 1 if step_info.phase == COARSE else 2
    own.train_stage(stage)
    target = step.target_of(inputs.batch)
    true_voxels = stage == 1 and step_info.step < loss.told * step_info.steps
    found: LIDFPrediction = own(
        *lidf_inputs(own, inputs), learns=stage, follow=target.depth if true_voxels else None
    )
    with torch.autocast(inputs.color.device.type, enabled=False):
        total, parts = loss(found, target, step_info.phase)
        if not total.requires_grad:  # frames without any believed measurement have no answer
            learning = [p.sum() for p in own.parameters() if p.requires_grad]
            total = total + 0 * torch.stack(learning).sum()
    return step.Loss(total, parts)


def lidf_depth(network: nn.Module, batch: step.Batch) -> Tensor:
    """(b, h, w) metres after both stages."""
    own = cast(LIDFNetwork, network)
    return own(*lidf_inputs(own, step.model_input(batch))).depth[:, 0]
