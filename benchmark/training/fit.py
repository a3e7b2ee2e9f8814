"""A training, from its configuration to the best weights."""

import os
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import torch
from msgspec.structs import replace

from benchmark.methods.weights import save_weights
from benchmark.training import catalogue, options, packed_frames, run_files, run_note
from benchmark.training.config import CONFIG, TrainConfig, begin, seed_of
from std_toolkit.errors import ToolkitError, is_interrupt
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.io.documents import digest_file, write_document
from std_toolkit.io.locks import hold_lock
from std_toolkit.jobs.artefact import check_begun
from std_toolkit.log import logger


@dataclass(frozen=True)
class Beginning:
    """Weights that a training begins with.

    Attributes:
        weights: file of weights of the same network, or of one that it may begin with.
        imagenet: file of weights of a classifier.
    """

    weights: Path | None = None
    imagenet: Path | None = None


def fit(
    folder: Path,
    config: TrainConfig,
    data: packed_frames.Data,
    machine: options.Machine | None = None,
    beginning: Beginning | None = None,
) -> Path:
    """Train, or go on with the training that was begun in the folder.

    Returns:
        The best weights, as safetensors.

    Raises:
        ToolkitError: the folder holds another training or a damaged file, a batch cannot be parted
            among the devices, a loss or gradient that is not finite (the last checkpoint is kept),
            or a full disk.
        KeyboardInterrupt: SIGINT or SIGTERM came.
    """
    # Lightning takes seconds to load, which a plan need not wait for.
    from benchmark.training.callbacks import Watch
    from benchmark.training.module import RestorerTraining
    from benchmark.training.trainer import Loaders, lightning_trainer, quieten

    machine = machine or options.Machine()
    trainable = catalogue.get_trainable(config.method)
    is_first = process_rank() == 0
    loss = trainable.loss_with(config.loss)
    # Before anything is written: wrong weights leave no training behind.
    network = make_network(trainable, config, beginning or Beginning())
    with ExitStack() as stack:
        if is_first:
            check_begun(folder / CONFIG, hint="choose another --out")
            data.training.check(data.of_training)
            data.validation.check(data.of_validation)
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(hold_lock(folder, "lock", doing="training in", what="folder"))
            begin(folder, config)
            sweep_temporaries(folder)
            if not (folder / run_note.RUN_NOTE).exists():
                note = run_note.note_of(
                    data.training,
                    data.of_training,
                    data.validation,
                    data.of_validation,
                    None if beginning is None else beginning.weights,
                )
                write_document(folder / run_note.RUN_NOTE, note)
        quieten()
        module = RestorerTraining(config, network, trainable.step, loss, data.training.key)
        validator = trainable.validator(
            data.validation, data.of_validation, _validation_batch(config), loss
        )
        watch = Watch(folder, validator, log_every=machine.log_every)
        trainer = lightning_trainer(trainable, config, machine, watch, folder)
        checkpoint = folder / run_files.CHECKPOINT
        try:
            trainer.fit(
                module,
                datamodule=Loaders(data, config, machine.readers, folder / ".std" / "lock"),
                ckpt_path=checkpoint if checkpoint.exists() else None,
            )
        except SystemExit as ended:
            if is_interrupt(ended):
                raise KeyboardInterrupt from ended  # Lightning exits by itself
            raise
        if trainer.is_global_zero:
            last = folder / run_files.LAST
            save_weights(module.network, last)
            digests = replace(run_files.read_digests(folder), weights=digest_file(last))
            write_document(folder / run_files.DIGESTS, digests)
            if (folder / run_files.SCORES).is_file():
                run_files.read_best(folder)
            figures = watch.speed.figures()
            if watch.speed.samples:
                logger.info(
                    "%d samples at %.1f/s, %.1f %% of the time waiting for data",
                    watch.speed.samples,
                    figures["samples_per_s"],
                    100 * figures["waiting_for_data"],
                )
    return folder / run_files.BEST


def make_network(
    trainable: catalogue.Trainable, config: TrainConfig, beginning: Beginning
) -> torch.nn.Module:
    """The network with the weights that training begins with.

    Raises:
        ToolkitError: a setting or weights that it cannot have.
    """
    torch.manual_seed(seed_of(config.seed))
    network = trainable.network(trainable.config(config.preset, config.settings))
    if beginning.imagenet is not None:
        if trainable.imagenet is None:
            raise ToolkitError(
                "the method does not begin with a classifier's weights",
                field="--imagenet",
                value=config.method,
            )
        trainable.imagenet(network, beginning.imagenet)
    if beginning.weights is not None:
        if beginning.weights.name == run_files.BEST:
            beside = beginning.weights.parent
            if (beside / run_files.SCORES).is_file():
                run_files.read_best(beside)
        trainable.begin(network, beginning.weights)
    if trainable.channels_last:
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # missing in its stub
    return network


def _validation_batch(config: TrainConfig) -> int:
    return max(1, config.optimization.batch_size // config.accumulate)


def process_rank() -> int:
    """Number of this process, before Lightning knows it."""
    for name in ("RANK", "SLURM_PROCID", "LOCAL_RANK"):
        if name in os.environ:
            return int(os.environ[name])
    return 0
