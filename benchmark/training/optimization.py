"""How the weights follow the gradients: optimizer and learning rate by step."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import nn

# A warm-up that was published for 60,000 steps must not fill a short training.
_LONGEST_WARMUP = 0.1


@dataclass(frozen=True, kw_only=True)
class Optimization:
    """Optimizer and schedule.

    Attributes:
        optimizer: `adam` or `adamw`.
        learning_rate, betas, weight_decay: of the optimizer.
        batch_size: frames of a step, over all devices and accumulated parts.
        epochs: how often every frame is seen, where no number of steps is asked for.
        decay: `linear` falls to 0 at the end; `steps` multiplies by `factor` at each of
            `milestones`.
        milestones: shares of the training, in (0, 1).
        factor: see `decay`.
        warmup_steps: steps in which the rate rises from almost 0, but at most a tenth of all.
        warmup_share: the same as a share of the training; the longer of both counts.
    """

    optimizer: Literal["adam", "adamw"] = "adamw"
    learning_rate: float = 1e-4
    betas: tuple[float, float] = (0.9, 0.999)
    weight_decay: float = 0.01
    batch_size: int = 32
    epochs: int = 20
    decay: Literal["linear", "steps"] = "linear"
    milestones: tuple[float, ...] = ()
    factor: float = 1.0
    warmup_steps: int = 0
    warmup_share: float = 0.0

    def make(self, parameters: Iterable[nn.Parameter]) -> torch.optim.Optimizer:
        """The optimizer of these parameters."""
        kind = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW}[self.optimizer]
        return kind(
            parameters, self.learning_rate, betas=self.betas, weight_decay=self.weight_decay
        )

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
