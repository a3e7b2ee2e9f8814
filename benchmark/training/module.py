"""A training step: frames to a loss, all that is drawn in it being a function of its number."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import pytorch_lightning as pl
import torch
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND
from benchmark.methods.network import Prediction
from benchmark.training.config import TrainConfig
from benchmark.training.losses.terms import LossFunction, Target
from std_toolkit.errors import ToolkitError

_TOLD = 8  # frames named in an error


class RestorerTraining(pl.LightningModule):
    """A network in training.

    Args:
        config: of the training.
        network: `network(color, depth) -> Prediction`.
        loss: what is minimised.
        key: name of a frame by its index.

    A step whose loss or gradients are not finite raises `ToolkitError` before it changes a weight.
    """

    def __init__(
        self,
        config: TrainConfig,
        network: nn.Module,
        loss: LossFunction,
        key: Callable[[int], str],
    ) -> None:
        super().__init__()
        self.config, self.network, self.loss, self.key = config, network, loss, key
        self.parts: dict[str, Tensor] = {}
        self._frames: list[int] = []
        self._change_color: Callable[[Tensor], Tensor] | None = None
        if config.colors:
            from benchmark.training.augmentation import ColorAugmentation

            self._change_color = ColorAugmentation()

    def training_step(self, batch: Mapping[str, Tensor], batch_idx: int) -> Tensor:
        part = batch_idx % self.config.accumulate
        frames = batch["index"].tolist()
        self._frames = frames if part == 0 else self._frames + frames
        # No generator's state has to survive an interruption: dropout and augmentation of a step
        # depend on its number alone.
        torch.manual_seed(seed_of(self.config.seed, self.global_step, part, self.global_rank))
        color, depth = network_inputs(batch)
        if self._change_color is not None:
            color = self._change_color(color)
        if self.config.holes:
            from benchmark.training.augmentation import lose_objects

            depth = lose_objects(depth, batch["mask"], self.config.holes)
        prediction = in_full_precision(self.network(color, depth))
        with torch.autocast(self.device.type, enabled=False):
            loss = self.loss(prediction, target_of(batch))
        if not torch.isfinite(loss.total):
            self._stop("the loss is not a number", {n: float(p) for n, p in loss.parts.items()})
        self.parts = {"loss": loss.total.detach(), **loss.parts}
        return loss.total

    def on_before_optimizer_step(self, optimizer: torch.optim.Optimizer) -> None:  # noqa: ARG002
        gradients = [p.grad for p in self.parameters() if p.grad is not None]
        norm = torch.nn.utils.get_total_norm(gradients)
        self.parts["gradient"] = norm
        if not torch.isfinite(norm):
            self._stop("the gradients are not numbers", None)

    def configure_optimizers(self) -> Any:
        config = self.config
        optimizer = config.optimization.make(self.network.parameters())
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: config.optimization.rate(step, config.steps)
        )
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    def _stop(self, problem: str, value: object) -> None:
        names = [self.key(i) for i in self._frames[:_TOLD]]
        more = len(self._frames) - len(names)
        told = ", ".join(names) + (f" and {more} more" if more else "")
        raise ToolkitError(
            f"{problem} at step {self.global_step}, frames {told}",
            value=value,
            hint="the last checkpoint is kept; look at these frames, or make --learning-rate "
            "smaller",
        )


def seed_of(*numbers: int) -> int:
    """A seed for every row of numbers, as unlike to its neighbours' as any other."""
    digest = hashlib.blake2b(repr(numbers).encode(), digest_size=7).digest()
    return int.from_bytes(digest, "little")


def network_inputs(batch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """(b, 3, h, w) colour in [0, 1] and (b, 1, h, w) the sensor's depth, metres."""
    color = batch["color"].permute(0, 3, 1, 2).float() / 255
    return color.contiguous(), batch["raw"][:, None]


def target_of(batch: Mapping[str, Tensor]) -> Target:
    """What the network should answer to a batch."""
    return Target(batch["true"][:, None], (batch["mask"] != BACKGROUND)[:, None], batch["K"])


def in_full_precision(prediction: Prediction) -> Prediction:
    """The same in float32."""
    return Prediction(*(None if p is None else p.float() for p in prediction))  # type: ignore[arg-type]
