"""How the weights follow the gradients: optimizer and learning rate by step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import nn

# A warm-up that was published for 60,000 steps must not fill a short training.
_LONGEST_WARMUP = 0.1


@dataclass(frozen=True, kw_only=True)
class Optimization:
    """Optimizer and schedule.

    Attributes:
        optimizer: `adam`, `adamw` or `sgd`.
        learning_rate, betas, momentum, weight_decay: of the optimizer; `momentum` is `sgd`'s,
            `betas` the others'.
        batch_size: frames of a step, over all devices and accumulated parts.
        epochs: how often every frame is seen, where no number of steps is asked for.
        decay: `linear` falls to 0 at the end; `steps` multiplies by `factor` at each of
            `milestones`.
        milestones: shares of the training, in (0, 1).
        factor: see `decay`.
        warmup_steps: steps in which the rate rises from almost 0, but at most a tenth of all.
        warmup_share: the same as a share of the training; the longer of both counts.
        phase_epochs: epochs of the phases of a training that has several, in their order, which
            add up to `epochs`; of another number of epochs each has the same share. `decay` and
            warm-up are each phase's own.
        phase_rates: by what the learning rate is multiplied in phases, if not by 1.
    """

    optimizer: Literal["adam", "adamw", "sgd"] = "adamw"
    learning_rate: float = 1e-4
    betas: tuple[float, float] = (0.9, 0.999)
    momentum: float = 0.9
    weight_decay: float = 0.01
    batch_size: int = 32
    epochs: int = 20
    decay: Literal["linear", "steps"] = "linear"
    milestones: tuple[float, ...] = ()
    factor: float = 1.0
    warmup_steps: int = 0
    warmup_share: float = 0.0
    phase_epochs: Mapping[str, int] = field(default_factory=dict)
    phase_rates: Mapping[str, float] = field(default_factory=dict)

    def make(self, parameters: Iterable[nn.Parameter]) -> torch.optim.Optimizer:
        """The optimizer of these parameters."""
        if self.optimizer == "sgd":
            return torch.optim.SGD(
                parameters, self.learning_rate, self.momentum, weight_decay=self.weight_decay
            )
        kind = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW}[self.optimizer]
        return kind(
            parameters, self.learning_rate, betas=self.betas, weight_decay=self.weight_decay
        )

    def phases(self, steps: int) -> dict[str, int]:
        """Steps of each phase of a training of `steps` steps; none for one of a single phase."""
        total, begun, end = sum(self.phase_epochs.values()), 0, 0
        found = {}
        for name, epochs in self.phase_epochs.items():
            begun, before = begun + epochs, end
            end = round(steps * begun / total)
            found[name] = end - before
        return found

    def rate(self, step: int, steps: int) -> float:
        """Share of the learning rate at a step, counted from 0, of a training of `steps` steps."""
        if self.decay == "linear":
            share = max(0.0, 1 - step / steps)
        else:
            share = self.factor ** sum(step >= m * steps for m in self.milestones)
        warmup = max(min(self.warmup_steps, _LONGEST_WARMUP * steps), self.warmup_share * steps)
        if step < warmup:
            # From a millionth, as published for SwinDRNet.
            share *= 1 - (1 - step / warmup) * (1 - 1e-6)
        return share
