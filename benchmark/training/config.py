"""Configuration of a training, with the optimizer and the learning rate schedule."""

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import torch
from torch import nn

from benchmark.training.options import BatchNormStatistics, Precision
from benchmark.training.step import StepInfo
from std_toolkit.errors import CheckedOptions, ToolkitError
from std_toolkit.jobs import artefact

# A warm-up that was published for 60,000 steps must not fill a short training.
_LONGEST_WARMUP = 0.1

CONFIG = "config.json"

# Of a method: its name in the registry, package.module:NAME or file.py:NAME.
_NAME = re.compile(r"[\w.-]+|[^\0\n]+:[A-Za-z_]\w*")


# Larger numbers are damage: no published training comes near them.
_Count = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
_Rate = Annotated[float, msgspec.Meta(gt=0, le=10)]


@dataclass(frozen=True, kw_only=True)
class Optimization(CheckedOptions):
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
        encoder_rate: by what it is multiplied for the network's `encoder`, which begins with
            weights of a classifier.
    """

    optimizer: Literal["adam", "adamw", "sgd"] = "adamw"
    learning_rate: _Rate = 1e-4
    betas: tuple[float, float] = (0.9, 0.999)
    momentum: float = 0.9
    weight_decay: float = 0.01
    batch_size: _Count = 32
    epochs: _Count = 20
    decay: Literal["linear", "steps"] = "linear"
    milestones: tuple[float, ...] = ()
    factor: float = 1.0
    warmup_steps: int = 0
    warmup_share: float = 0.0
    phase_epochs: Mapping[str, int] = field(default_factory=dict)
    phase_rates: Mapping[str, float] = field(default_factory=dict)
    encoder_rate: float = 1.0

    def make(self, network: nn.Module) -> torch.optim.Optimizer:
        """The optimizer of the network's parameters."""
        parameters: Iterable[Any] = network.parameters()
        if self.encoder_rate != 1:
            rate = self.encoder_rate * self.learning_rate
            encoder = {id(p) for p in network.get_submodule("encoder").parameters()}
            parameters = [
                {"params": [p for p in network.parameters() if id(p) in encoder], "lr": rate},
                {"params": [p for p in network.parameters() if id(p) not in encoder]},
            ]
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


# Adam in steps without weight decay, as many methods are published.
ADAM = Optimization(optimizer="adam", weight_decay=0.0, decay="steps")


# Shares, of frames or of objects, that augmentation changes.
AUGMENTATIONS = (
    "object_dropout", "copy_paste", "clear_gone", "clear_behind", "holes", "depth_noise",
    "wrong_color", "patterns",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """A training.

    Attributes:
        method, preset, settings: the network.
        loss: changes to the method's loss, by field.
        optimization: optimizer and schedule.
        steps: how many there are.
        phases: steps of each phase, one after the other; empty for a training of one phase.
        accumulate: parts of a step that go through the network one after the other.
        precision: of the network's arithmetic.
        seed: of weights, order, augmentation and dropout.
        colors: whether colour is augmented as published for SwinDRNet.
        jitter: whether brightness, contrast and saturation are, as published for NLSPN.
        geometry: whether frames are turned, mirrored and enlarged, as published for NLSPN.
        object_dropout: share of the frames in which the depth of some objects is replaced.
        copy_paste: share of the frames into which objects of another frame are pasted.
        clear_gone, clear_behind: shares of the glass and metal objects without sensor depth, and
            with that of what is behind.
        holes: share of the frames with holes anywhere.
        wrong_color: share of the frames with noise or another frame's colour.
        depth_noise: share of the frames whose sensor depth has more noise.
        patterns: share of the frames whose background has a random pattern of colour.
        sizes: of the frames, such as 224x126: each step draws one; empty for that of the pack.
        batch_norm: whether trained weights normalise by running means over the last batches, as
            published, or by statistics that are recomputed before each validation.
        validate_every, checkpoint_every: steps; the first a multiple of the second.
        training, validation: hashes over the frames.
        beginning: hash of the file of weights to begin with, and of what it is; empty for none.
    """

    method: str
    preset: str
    settings: dict[str, str] = field(default_factory=dict)
    loss: dict[str, str] = field(default_factory=dict)
    optimization: Optimization
    steps: int
    phases: dict[str, int] = field(default_factory=dict)
    accumulate: int = 1
    precision: Precision = "fp32"
    seed: int = 0
    colors: bool = True
    jitter: bool = False
    geometry: bool = False
    object_dropout: float = 0.0
    copy_paste: float = 0.0
    clear_gone: float = 0.0
    clear_behind: float = 0.0
    holes: float = 0.0
    wrong_color: float = 0.0
    depth_noise: float = 0.0
    patterns: float = 0.0
    sizes: tuple[str, ...] = ()
    batch_norm: BatchNormStatistics = "running"
    validate_every: int
    checkpoint_every: int
    training: str
    validation: str
    beginning: str = ""

    def __post_init__(self) -> None:
        for name in ("method", "preset"):
            if not _NAME.fullmatch(getattr(self, name)):
                raise ToolkitError("is no name", field=name, value=getattr(self, name))
        for name in ("steps", "accumulate", "validate_every", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ToolkitError("must be at least 1", field=name, value=getattr(self, name))
        if self.phases and sum(self.phases.values()) != self.steps:
            raise ToolkitError(
                f"phases must add up to {self.steps} steps", field="phases", value=self.phases
            )
        if self.validate_every % self.checkpoint_every:
            raise ToolkitError(
                f"must be a multiple of checkpoint_every, {self.checkpoint_every}",
                field="validate_every",
                value=self.validate_every,
            )
        for name in AUGMENTATIONS:
            if not 0 <= getattr(self, name) <= 1:
                raise ToolkitError("must be in [0, 1]", field=name, value=getattr(self, name))

    @property
    def label(self) -> str:
        """Name of the network for files: no path, whatever the method is called."""
        method = self.method.rpartition(":")[2]
        return f"{method}-{self.preset.rpartition(':')[2]}"

    def step_info(self, step: int) -> StepInfo:
        """Where a step stands, counted from 0; behind the end, at the end of the last phase."""
        if not self.phases:
            return StepInfo("", step, self.steps)
        phases = [(name, steps) for name, steps in self.phases.items() if steps]
        for name, steps in phases:
            if step < steps:
                return StepInfo(name, step, steps)
            step -= steps
        name, steps = phases[-1]
        return StepInfo(name, steps + step, steps)

    def rate(self, step: int) -> float:
        """The learning rate of a step."""
        phase, at, steps = self.step_info(step)
        share = self.optimization.rate(at, steps) * self.optimization.phase_rates.get(phase, 1.0)
        return share * self.optimization.learning_rate


def begin(folder: Path, config: TrainConfig) -> None:
    """Keep the configuration of a new training, or see that the one begun there is the same.

    Raises:
        ToolkitError: another training was begun there; lists all differences.
    """
    hint = "give the same options to go on, or another --out"
    artefact.begin(folder / CONFIG, config, what="this training was", hint=hint)


def seed_of(*numbers: int) -> int:
    """A seed for every row of numbers, as unlike to its neighbours' as any other."""
    digest = hashlib.blake2b(repr(numbers).encode(), digest_size=7).digest()
    return int.from_bytes(digest, "little")
