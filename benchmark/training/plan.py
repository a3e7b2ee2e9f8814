"""Resolves the options of `std-train` to a training."""

from dataclasses import replace
from typing import Any

from benchmark.training import fit, frame_order, packed_frames
from benchmark.training.catalogue import Trainable, get_trainable
from benchmark.training.config import AUGMENTATIONS, Optimization, TrainConfig
from benchmark.training.options import TrainOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_file

# Of a training of few steps, so that killing it never costs more than a part of it.
_CHECKPOINTS = 20
_LONGEST_INTERVAL = 500


def plan_training(options: TrainOptions) -> tuple[TrainConfig, packed_frames.Data, fit.Beginning]:
    """The configuration, frames and first weights of a training.

    Raises:
        ToolkitError: an unknown method or setting, too little data, data of another size than the
            network's, scenes both in training and in validation, or numbers that make no sense.
    """
    trainable = get_trainable(options.method)
    settings = trainable.settings_of(options.preset, options.settings)
    network = trainable.config(options.preset, settings)
    trainable.loss_with(options.loss)  # fail on a wrong name before reading
    data = _data(options, trainable, network)
    changes = {
        name: value
        for name in (
            "epochs", "batch_size", "learning_rate", "weight_decay", "optimizer", "decay"
        )
        if (value := getattr(options, name)) is not None
    }  # fmt: skip
    optimization = replace(trainable.optimization, **changes)
    order = frame_order.BatchOrder(
        len(data.of_training), optimization.batch_size, seed=options.seed
    )
    phases = _phases(options, optimization, order.steps_per_epoch)
    steps = sum(phases.values())
    every = options.checkpoint_every
    if every is None:
        every = max(1, min(_LONGEST_INTERVAL, steps // _CHECKPOINTS))
    about_an_epoch = max(1, round(min(order.steps_per_epoch, steps) / max(1, every))) * every
    copied = (
        "method", "preset", "accumulate", "precision", "seed", "batch_norm", "sizes",
        *AUGMENTATIONS,
    )  # fmt: skip
    config = TrainConfig(
        **{name: getattr(options, name) for name in copied},
        settings=settings,
        loss=dict(options.loss),
        optimization=optimization,
        steps=steps,
        phases={name: count for name, count in phases.items() if name},
        colors=trainable.colors if options.colors == "published" else options.colors == "on",
        jitter=trainable.jitter if options.colors == "published" else options.colors == "jitter",
        geometry=_geometry(options, trainable),
        validate_every=options.validate_every or about_an_epoch,
        checkpoint_every=every,
        training=frame_order.frames_digest(data.training, data.of_training),
        validation=frame_order.frames_digest(data.validation, data.of_validation),
        beginning=_digest(options),
    )
    if not trainable.images and (
        config.colors or config.jitter or any(getattr(config, name) for name in AUGMENTATIONS)
    ):
        raise ToolkitError(
            "the method is trained on clouds: there are no images to augment",
            field=", ".join(f"--{n.replace('_', '-')}" for n in ("colors", *AUGMENTATIONS)),
            value=options.method,
        )
    return config, data, fit.Beginning(options.weights, options.imagenet)


def _phases(
    options: TrainOptions, optimization: Optimization, steps_per_epoch: int
) -> dict[str, int]:
    """Steps of each phase; of a training without phases all of them, without a name."""
    known = optimization.phase_epochs
    if not options.phases:
        steps = optimization.epochs * steps_per_epoch if options.steps is None else options.steps
        return optimization.phases(steps) or {"": steps}
    for name, steps in options.phases.items():
        if name not in known:
            hint = f"it has {', '.join(known)}" if known else "its training has only one"
            raise ToolkitError("the method has no such phase", field=name, hint=hint)
        if steps < 0:
            raise ToolkitError("must not be negative", field=name, value=steps)
    if options.steps is not None or options.epochs is not None:
        raise ToolkitError("do not go with --steps or --epochs", field="--phases")
    return {name: options.phases.get(name, 0) for name in known}


def _geometry(options: TrainOptions, trainable: Trainable) -> bool:
    if options.geometry == "on" and trainable.geometry is None:
        raise ToolkitError(
            "frames of this method cannot be moved", field="--geometry", value=options.method
        )
    return bool(trainable.geometry) if options.geometry == "published" else options.geometry == "on"


def _data(options: TrainOptions, trainable: Trainable, network: Any) -> packed_frames.Data:
    training = trainable.frames(options.data, network)
    if options.validation:
        validation = trainable.frames(options.validation, network)
        of_training, of_validation = list(range(len(training))), list(range(len(validation)))
    else:
        validation = training
        of_training, of_validation = frame_order.hold_out(
            training, options.hold_out, seed=options.seed
        )
    of_training = frame_order.thinned(training, of_training, options.share, seed=options.seed)
    frame_order.check_no_leak(training, of_training, validation, of_validation)
    return packed_frames.Data(training, of_training, validation, of_validation)


def _digest(options: TrainOptions) -> str:
    files = {"weights": options.weights, "imagenet": options.imagenet}
    digests = []
    for name, path in files.items():
        if path is None:
            continue
        if not path.is_file():
            raise ToolkitError("no such file of weights", path=path)
        digests.append(f"{name} {digest_file(path)}")
    return ", ".join(digests)
