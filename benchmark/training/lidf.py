"""How LIDF is trained: what a batch is for it, and what each phase does with it."""

from __future__ import annotations

from typing import Any, Literal, cast

import torch
from torch import Tensor, nn

from benchmark.data.frame import Material
from benchmark.methods.lidf.network import LIDFNetwork, LIDFPrediction
from benchmark.training.losses.lidf import COARSE, LIDFLoss
from benchmark.training.losses.surfaces import points
from benchmark.training.losses.terms import Loss
from benchmark.training.step import Batch, Moment, Seen, made_of, seen_of, target_of


def lidf_inputs(network: LIDFNetwork, seen: Seen) -> tuple[Tensor, ...]:
    """Colour, depth, rays, which depth is believed and which pixels are asked for, as the restorer
    gives them to the network."""
    color, depth, batch = seen
    rays = points(torch.ones_like(depth), batch["K"])
    believed = depth > 0
    if network.config.mask == "objects":
        believed &= ~made_of(batch, Material.TRANSPARENT, Material.SPECULAR)[:, None]
    asked = torch.ones_like(believed) if network.config.predict == "all" else ~believed
    return color, depth, rays, believed, asked


def lidf_step(network: nn.Module, loss: Any, seen: Seen, moment: Moment) -> Loss:
    """The first stage learns in the phase `coarse`, at its beginning told the true voxels; in the
    others the second one does."""
    own, loss = cast(LIDFNetwork, network), cast(LIDFLoss, loss)
    stage: Literal[1, 2] = 1 if moment.phase == COARSE else 2
    own.train_stage(stage)
    target = target_of(seen.batch)
    told = stage == 1 and moment.step < loss.told * moment.steps
    found: LIDFPrediction = own(
        *lidf_inputs(own, seen), learns=stage, follow=target.depth if told else None
    )
    with torch.autocast(seen.color.device.type, enabled=False):
        total, parts = loss(found, target, moment.phase)
        if not total.requires_grad:  # frames without any believed measurement have no answer
            learning = [p.sum() for p in own.parameters() if p.requires_grad]
            total = total + 0 * torch.stack(learning).sum()
    return Loss(total, parts)


def lidf_depth(network: nn.Module, batch: Batch) -> Tensor:
    """(b, h, w) metres after both stages."""
    own = cast(LIDFNetwork, network)
    return own(*lidf_inputs(own, seen_of(batch))).depth[:, 0]
