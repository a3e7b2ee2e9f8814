"""What a network sees of a batch, and how a method makes a loss of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND, Material
from benchmark.methods.network import Prediction
from benchmark.training.losses.terms import Loss, Target

Batch = Mapping[str, Tensor]  # as `PackedFrames` gives it


class Seen(NamedTuple):
    """A batch, augmented.

    Attributes:
        color: (b, 3, h, w) RGB in [0, 1]; empty where a batch holds no images.
        depth: (b, 1, h, w) the sensor's, metres, 0 = none; likewise.
        batch: the frames, of which `color` and `raw` are as they were packed.
    """

    color: Tensor
    depth: Tensor
    batch: Batch


class Moment(NamedTuple):
    """A step's place in its phase of the training.

    Attributes:
        phase: name; empty for trainings of one phase.
        step: counted from 0.
        steps: of the phase.
    """

    phase: str = ""
    step: int = 0
    steps: int = 1


class StepFunction(Protocol):
    """Sends a batch through a network, in the arithmetic of the training, to a loss in float32.

    `loss` is the method's loss, as configured.
    """

    def __call__(self, network: nn.Module, loss: Any, seen: Seen, moment: Moment) -> Loss: ...


def depth_step(network: nn.Module, loss: Any, seen: Seen, moment: Moment) -> Loss:  # noqa: ARG001
    """The step of a network from colour and depth to `Prediction`."""
    prediction = in_full_precision(network(seen.color, seen.depth))
    with torch.autocast(seen.color.device.type, enabled=False):
        return loss(prediction, target_of(seen.batch)._replace(sensor=seen.depth))


def network_depth(network: nn.Module, batch: Batch) -> Tensor:
    """(b, h, w) metres that such a network restores."""
    return network(*network_inputs(batch)).depth[:, 0]


def seen_of(batch: Batch) -> Seen:
    """A batch as it is; of one without images there is nothing to augment."""
    if "color" not in batch:
        return Seen(*(batch["index"].new_zeros(0, dtype=torch.float32),) * 2, batch)
    return Seen(*network_inputs(batch), batch)


def network_inputs(batch: Batch) -> tuple[Tensor, Tensor]:
    """(b, 3, h, w) colour in [0, 1] and (b, 1, h, w) the sensor's depth, metres."""
    color = batch["color"].permute(0, 3, 1, 2).float() / 255
    return color.contiguous(), batch["raw"][:, None]


def target_of(batch: Batch) -> Target:
    """What the network should answer to a batch."""
    return Target(batch["true"][:, None], (batch["mask"] != BACKGROUND)[:, None], batch["K"])


def made_of(batch: Batch, *materials: Material) -> Tensor:
    """(b, h, w) bool pixels of objects of some materials."""
    ids = batch["mask"].flatten(1).long()
    material = batch["materials"].gather(1, ids).reshape(batch["mask"].shape)
    found = torch.zeros_like(material, dtype=torch.bool)
    for one in materials:
        found |= material == int(one)
    return found


def in_full_precision(prediction: Prediction) -> Prediction:
    """The same in float32."""
    return Prediction(*(None if p is None else p.float() for p in prediction))  # type: ignore[arg-type]
