"""Everything that decides what a training ends with; kept beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

from benchmark.training.optimization import Optimization
from benchmark.training.step import Moment
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import begin_folder

CONFIG = "config.json"


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
        holes: share of the frames in which depth of some objects is lost on top.
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
    precision: Literal["fp32", "bf16"] = "fp32"
    seed: int = 0
    colors: bool = True
    jitter: bool = False
    geometry: bool = False
    holes: float = 0.0
    validate_every: int
    checkpoint_every: int
    training: str
    validation: str
    beginning: str = ""

    def __post_init__(self) -> None:
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
        if not 0 <= self.holes <= 1:
            raise ToolkitError("must be in [0, 1]", field="holes", value=self.holes)

    def moment(self, step: int) -> Moment:
        """Where a step stands, counted from 0; behind the end, at the end of the last phase."""
        if not self.phases:
            return Moment("", step, self.steps)
        phases = [(name, steps) for name, steps in self.phases.items() if steps]
        for name, steps in phases:
            if step < steps:
                return Moment(name, step, steps)
            step -= steps
        name, steps = phases[-1]
        return Moment(name, steps + step, steps)

    def rate(self, step: int) -> float:
        """The learning rate of a step."""
        phase, at, steps = self.moment(step)
        share = self.optimization.rate(at, steps) * self.optimization.phase_rates.get(phase, 1.0)
        return share * self.optimization.learning_rate


def begin(folder: Path, config: TrainConfig) -> None:
    """Keep the configuration of a new training, or see that the one begun there is the same.

    Raises:
        ToolkitError: another was begun there; all that differs is told.
    """
    path = folder / CONFIG
    begun = flat(begin_folder(path, config, hint="choose another --out"))
    now = flat(config)
    differing = [name for name in {**begun, **now} if begun.get(name) != now.get(name)]
    if differing:
        told = "; ".join(f"{n}: {begun.get(n)!r} then, {now.get(n)!r} now" for n in differing)
        raise ToolkitError(
            f"the training there was begun with another configuration: {told}",
            path=path,
            hint="give the same options to go on, or another --out",
        )


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Fields of nested dataclasses and mappings by their paths."""
    if is_dataclass(value) and not isinstance(value, type):
        items = {f.name: getattr(value, f.name) for f in fields(value)}
    elif isinstance(value, Mapping):
        items = dict(value)
    else:
        return {prefix: list(value) if isinstance(value, tuple) else value}
    found: dict[str, Any] = {}
    for name, item in items.items():
        found |= flat(item, f"{prefix}.{name}" if prefix else name)
    return found
