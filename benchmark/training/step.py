"""Inputs and results of training steps: batches, losses, batch-norm statistics; protocols."""

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from benchmark.data.frame import BACKGROUND, Material
from benchmark.methods.network import Prediction

_LEAST = 1e-6  # so that no weight at all is no division by 0

Batch = Mapping[str, Tensor]  # as `PackedFrames` gives it


class Target(NamedTuple):
    """What the network should have answered.

    Attributes:
        depth: (b, 1, h, w) true metres, 0 where there is no ground truth.
        foreground: (b, 1, h, w) bool pixels of objects.
        K: (b, 3, 3) intrinsics at this size.
        sensor: (b, 1, h, w) metres that the network was given, 0 = none; for losses that look at
            it.
    """

    depth: Tensor
    foreground: Tensor
    K: Tensor
    sensor: Tensor | None = None


class Loss(NamedTuple):
    """A loss and what it is made of.

    Attributes:
        total: scalar, what is minimised.
        parts: scalars without gradient by name, for logs.
    """

    total: Tensor
    parts: dict[str, Tensor]


def constant(values: tuple[float, ...], like: Tensor) -> Tensor:
    """Numbers as a tensor of the type and on the device of `like`.

    It is made once: a graph of CUDA takes no numbers from the processor.
    """
    return _constant(values, like.dtype, like.device)


@lru_cache(maxsize=64)
def _constant(values: tuple[float, ...], kind: torch.dtype, on: torch.device) -> Tensor:
    with torch.inference_mode(False):
        return torch.tensor(values, dtype=kind, device=on)


def object_weights(target: Target, objects: float) -> Tensor:
    """(b, 1, h, w) what each pixel counts: pixels of objects `objects` times as much as others."""
    return target.foreground.to(target.depth.dtype) * (objects - 1) + 1


def weighted_mean(values: Tensor, weights: Tensor, dim: tuple[int, ...] | None = None) -> Tensor:
    """Mean over `dim`, or over all, of finite values by their weights; 0 where none has any."""
    return (values * weights).sum(dim=dim) / weights.sum(dim=dim).clamp(min=_LEAST)


def mean_where(values: Tensor, where: Tensor) -> Tensor:
    """Mean over the pixels where `where` is true; 0, with a gradient of 0, where there is none."""
    # Products would make NaN of what is not finite and does not count.
    chosen = values.masked_fill(~where, 0.0)
    return chosen.sum() / where.sum().clamp(min=1)


class ModelInput(NamedTuple):
    """A batch, augmented.

    Attributes:
        color: (b, 3, h, w) RGB in [0, 1]; empty where a batch holds no images.
        depth: (b, 1, h, w) the sensor's, metres, 0 = none; likewise.
        batch: the frames, of which `color` and `raw` are as they were packed.
    """

    color: Tensor
    depth: Tensor
    batch: Batch


class StepInfo(NamedTuple):
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

    def __call__(
        self, network: nn.Module, loss: Any, inputs: ModelInput, step_info: StepInfo
    ) -> Loss: ...


def depth_step(network: nn.Module, loss: Any, inputs: ModelInput, step_info: StepInfo) -> Loss:  # noqa: ARG001
    """The step of a network from colour and depth to `Prediction`."""
    prediction = in_full_precision(network(inputs.color, inputs.depth))
    with torch.autocast(inputs.color.device.type, enabled=False):
        return loss(prediction, target_of(inputs.batch)._replace(sensor=inputs.depth))


def network_depth(network: nn.Module, batch: Batch) -> Tensor:
    """(b, h, w) metres that such a network restores."""
    return network(*network_inputs(batch)).depth[:, 0]


def model_input(batch: Batch) -> ModelInput:
    """A batch as it is; of one without images there is nothing to augment."""
    if "color" not in batch:
        return ModelInput(*(batch["index"].new_zeros(0, dtype=torch.float32),) * 2, batch)
    return ModelInput(*network_inputs(batch), batch)


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


BATCH_NORM_FRAMES = 400  # that statistics are recomputed over


@torch.no_grad()
def recompute_batch_norm(
    network: nn.Module, batches: Iterable[Batch], run: Callable[[Batch], Any]
) -> None:
    """Set the running statistics to their means over batches, and nothing else.

    A network in training normalises by the statistics of each batch; a trained one by running means
    of them, of which the last ten batches decide most. Where a batch has few numbers for each
    channel, as at the top of a pooled pyramid, these means change from batch to batch, and with
    them the answers.

    Those of parts that are not in training mode, such as a frozen trunk, stay as they are.

    Args:
        network: whose weights stay as they are.
        batches: frames.
        run: sends a batch through the network.
    """
    norms = [part for part in network.modules() if isinstance(part, _BatchNorm) and part.training]
    if not norms:  # as in networks of transformers and perceptrons alone
        return
    momenta = [norm.momentum for norm in norms]
    modes = [(part, part.training) for part in network.modules()]
    network.eval()  # no dropout
    for norm in norms:
        norm.training = True
        norm.reset_running_stats()
        norm.momentum = None  # a mean over all batches
    for batch in batches:
        run(batch)
    for part, mode in modes:
        part.training = mode
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum
