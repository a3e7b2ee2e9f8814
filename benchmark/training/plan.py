"""From what a user types to a training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from benchmark.training.catalogue import Trainable, get_trainable
from benchmark.training.config import Optimization, TrainConfig
from benchmark.training.fit import Beginning
from benchmark.training.frame_order import (
    BatchOrder,
    check_no_leak,
    frames_digest,
    hold_out,
    thinned,
)
from benchmark.training.packed_frames import Data
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.document import digest_file

# Of a training of few steps, so that killing it never costs more than a part of it.
_CHECKPOINTS = 20
_LONGEST_INTERVAL = 500


@dataclass(frozen=True, kw_only=True)
class TrainWishes:
    """What a user asks for; None is what is published, or follows from the rest.

    Attributes:
        data, validation: packs; without the latter, scenes of the former are held out.
        hold_out: share of the scenes.
        share: of the scenes that are left, those that are trained on.
        steps, epochs: how long; `epochs` is left aside where there are `steps`.
        phases: steps of each phase, instead; those that are not named are left out.
        optimizer, decay, batch_size, learning_rate, weight_decay: as in `Optimization`.
        weights, imagenet: as in `Beginning`.
        colors: `published` for what was published for the method, `on` for SwinDRNet's,
            `jitter` for NLSPN's, `off`.
        geometry: whether frames are moved: `published` for what was published for the method.
        others: as in `TrainConfig`.
    """

    method: str
    preset: str = "compact"
    settings: Mapping[str, str] = field(default_factory=dict)
    loss: Mapping[str, str] = field(default_factory=dict)
    data: Sequence[Path]
    validation: Sequence[Path] = ()
    hold_out: float = 0.1
    share: float = 1.0
    steps: int | None = None
    epochs: int | None = None
    phases: Mapping[str, int] = field(default_factory=dict)
    optimizer: Literal["adam", "adamw", "sgd"] | None = None
    decay: Literal["linear", "steps"] | None = None
    batch_size: int | None = None
    learning_rate: float | None = None
    weight_decay: float | None = None
    accumulate: int = 1
    precision: Literal["fp32", "bf16"] = "fp32"
    seed: int = 0
    colors: Literal["published", "on", "jitter", "off"] = "published"
    geometry: Literal["published", "on", "off"] = "published"
    holes: float = 0.0
    validate_every: int | None = None
    checkpoint_every: int | None = None
    weights: Path | None = None
    imagenet: Path | None = None


def plan_training(wishes: TrainWishes) -> tuple[TrainConfig, Data, Beginning]:
    """The configuration, frames and first weights of a training.

    Raises:
        ToolkitError: an unknown method or setting, too little data, data of another size than the
            network's, scenes both in training and in validation, or numbers that make no sense.
    """
    trainable = get_trainable(wishes.method)
    settings = trainable.settings_of(wishes.preset, wishes.settings)
    network = trainable.config(wishes.preset, settings)
    trainable.loss_with(wishes.loss)  # a wrong name is told before anything is read
    data = _data(wishes, trainable, network)
    changes = {
        name: value
        for name in ("epochs", "batch_size", "learning_rate")
        if (value := getattr(wishes, name)) is not None
    }
    for name, value in changes.items():
        if not value > 0:
            raise ToolkitError("must be positive", field=name, value=value)
    if wishes.weight_decay is not None:
        if not wishes.weight_decay >= 0:
            raise ToolkitError(
                "must not be negative", field="weight_decay", value=wishes.weight_decay
            )
        changes["weight_decay"] = wishes.weight_decay
    for name in ("optimizer", "decay"):
        if (value := getattr(wishes, name)) is not None:
            changes[name] = value
    optimization = replace(trainable.optimization, **changes)
    order = BatchOrder(len(data.of_training), optimization.batch_size, seed=wishes.seed)
    phases = _phases(wishes, optimization, order.steps_per_epoch)
    steps = sum(phases.values())
    every = wishes.checkpoint_every
    if every is None:
        every = max(1, min(_LONGEST_INTERVAL, steps // _CHECKPOINTS))
    about_an_epoch = max(1, round(min(order.steps_per_epoch, steps) / max(1, every))) * every
    config = TrainConfig(
        method=wishes.method,
        preset=wishes.preset,
        settings=settings,
        loss=dict(wishes.loss),
        optimization=optimization,
        steps=steps,
        phases={name: count for name, count in phases.items() if name},
        accumulate=wishes.accumulate,
        precision=wishes.precision,
        seed=wishes.seed,
        colors=trainable.colors if wishes.colors == "published" else wishes.colors == "on",
        jitter=trainable.jitter if wishes.colors == "published" else wishes.colors == "jitter",
        geometry=_geometry(wishes, trainable),
        holes=wishes.holes,
        validate_every=(about_an_epoch if wishes.validate_every is None else wishes.validate_every),
        checkpoint_every=every,
        training=frames_digest(data.training, data.of_training),
        validation=frames_digest(data.validation, data.of_validation),
        beginning=_digest(wishes),
    )
    if not trainable.images and (config.colors or config.jitter or config.holes):
        raise ToolkitError(
            "the method is trained on clouds: there are no images to augment",
            field="--colors, --holes",
            value=wishes.method,
        )
    return config, data, Beginning(wishes.weights, wishes.imagenet)


def _phases(
    wishes: TrainWishes, optimization: Optimization, steps_per_epoch: int
) -> dict[str, int]:
    """Steps of each phase; of a training without phases all of them, without a name."""
    known = optimization.phase_epochs
    if not wishes.phases:
        steps = optimization.epochs * steps_per_epoch if wishes.steps is None else wishes.steps
        return optimization.phases(steps) or {"": steps}
    for name, steps in wishes.phases.items():
        if name not in known:
            told = f"it has {', '.join(known)}" if known else "its training has only one"
            raise ToolkitError("the method has no such phase", field=name, hint=told)
        if steps < 0:
            raise ToolkitError("must not be negative", field=name, value=steps)
    if wishes.steps is not None or wishes.epochs is not None:
        raise ToolkitError("do not go with --steps or --epochs", field="--phases")
    return {name: wishes.phases.get(name, 0) for name in known}


def _geometry(wishes: TrainWishes, trainable: Trainable) -> bool:
    if wishes.geometry == "on" and trainable.geometry is None:
        raise ToolkitError(
            "frames of this method cannot be moved", field="--geometry", value=wishes.method
        )
    return bool(trainable.geometry) if wishes.geometry == "published" else wishes.geometry == "on"


def _data(wishes: TrainWishes, trainable: Trainable, network: Any) -> Data:
    training = trainable.frames(wishes.data, network)
    if wishes.validation:
        validation = trainable.frames(wishes.validation, network)
        of_training, of_validation = list(range(len(training))), list(range(len(validation)))
    else:
        validation = training
        of_training, of_validation = hold_out(training, wishes.hold_out, seed=wishes.seed)
    of_training = thinned(training, of_training, wishes.share, seed=wishes.seed)
    check_no_leak(training, of_training, validation, of_validation)
    return Data(training, of_training, validation, of_validation)


def _digest(wishes: TrainWishes) -> str:
    files = {"weights": wishes.weights, "imagenet": wishes.imagenet}
    told = []
    for name, path in files.items():
        if path is None:
            continue
        if not path.is_file():
            raise ToolkitError("no such file of weights", path=path)
        told.append(f"{name} {digest_file(path)}")
    return ", ".join(told)
