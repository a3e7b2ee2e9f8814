"""The Lightning trainer with this toolkit's settings.

Checkpoints are written atomically and loaded without executing code.
"""

from __future__ import annotations

import logging
import os
import pickle
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytorch_lightning as pl
import torch
from pytorch_lightning.plugins import CheckpointIO
from pytorch_lightning.strategies import DDPStrategy
from torch.utils.data import DataLoader

from benchmark.training import (
    callbacks,
    catalogue,
    frame_order,
    options,
    packed_frames,
    run_files,
)
from benchmark.training.config import TrainConfig
from benchmark.training.run_files import LastFiles
from benchmark.training.step import Batch
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.documents import digest_file, write_document

_PRECISIONS: dict[str, Any] = {"fp32": "32-true", "bf16": "bf16-mixed"}


def lightning_trainer(
    trainable: catalogue.Trainable,
    config: TrainConfig,
    machine: options.Machine,
    watch: callbacks.Watch,
    folder: Path,
) -> pl.Trainer:
    """Writes nothing by itself but checkpoints; `watch` does the rest."""
    strategy: Any = "auto"
    plugins: list[Any] = [AtomicCheckpoints()]
    idle = trainable.idle(trainable.config(config.preset, config.settings))
    if machine.in_ray:
        from ray.train.lightning import RayDDPStrategy, RayLightningEnvironment

        strategy = RayDDPStrategy(find_unused_parameters=idle)
        plugins.append(RayLightningEnvironment())
    elif machine.devices * machine.nodes > 1:
        strategy = DDPStrategy(find_unused_parameters=idle)
    return pl.Trainer(
        accelerator=machine.accelerator,
        devices="auto" if machine.in_ray else machine.devices,
        num_nodes=machine.nodes,
        strategy=strategy,
        precision=_PRECISIONS[config.precision],
        max_epochs=-(-config.steps // config.checkpoint_every),
        accumulate_grad_batches=config.accumulate,
        callbacks=[watch],
        plugins=plugins,
        default_root_dir=folder,
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        enable_progress_bar=machine.progress,
        limit_val_batches=0,
        num_sanity_val_steps=0,
        use_distributed_sampler=False,
    )


def quieten() -> None:
    """Advice of Lightning that does not concern users of std-train."""
    logging.getLogger("pytorch_lightning").setLevel(logging.WARNING)
    logging.getLogger("lightning_fabric").setLevel(logging.WARNING)
    for text in (
        ".*does not have many workers.*",
        ".*`LeafSpec`.*",
        ".*isinstance.*LeafSpec.*",
        "Grad strides do not match",
    ):
        warnings.filterwarnings("ignore", text)


class Loaders(pl.LightningDataModule):
    """Batches in the order of the configuration, wherever a training goes on.

    Args:
        data: packed frames.
        config: of the training.
        readers: processes that read.
        lock: file of the run's lock, which readers let go of.
    """

    def __init__(
        self, data: packed_frames.Data, config: TrainConfig, readers: int, lock: Path
    ) -> None:
        super().__init__()
        self.data, self.config, self.readers, self.lock = data, config, readers, lock

    def train_dataloader(self) -> DataLoader[Any]:
        trainer, config = self.trainer, self.config
        assert trainer is not None
        chosen, order = self._ordered()
        steps = frame_order.Steps(
            order,
            lambda: trainer.global_step,
            steps=config.checkpoint_every,
            end=config.steps,
            accumulate=config.accumulate,
            rank=trainer.global_rank,
            world=trainer.world_size,
        )
        return DataLoader(
            chosen,
            sampler=steps,
            batch_size=None,
            num_workers=self.readers,
            persistent_workers=self.readers > 0,
            prefetch_factor=4 if self.readers else None,
            pin_memory=torch.cuda.is_available(),
            worker_init_fn=partial(_let_go, self.lock),
        )

    def first(self, count: int) -> Iterator[Batch]:
        """At least `count` frames, those of the first steps, the same ones in every process."""
        assert self.trainer is not None
        chosen, order = self._ordered()
        part = order.batch // (self.config.accumulate * self.trainer.world_size)  # memory holds it
        for step in range(-(-count // order.batch)):
            frames = order.batch_of(step).tolist()
            yield from (chosen[frames[i : i + part]] for i in range(0, order.batch, part))

    def _ordered(self) -> tuple[_Chosen, frame_order.BatchOrder]:
        """The frames to train on, and the order of their batches."""
        chosen, config = _Chosen(self.data.training, self.data.of_training), self.config
        batch = config.optimization.batch_size
        return chosen, frame_order.BatchOrder(len(chosen), batch, seed=config.seed)


class _Chosen(torch.utils.data.Dataset[dict[str, torch.Tensor]]):
    """A subset of the frames, renumbered for the order, with their own numbers in the batch."""

    def __init__(self, frames: packed_frames.PackedFrames, chosen: Sequence[int]) -> None:
        self.frames, self.chosen = frames, list(chosen)

    def __len__(self) -> int:
        return len(self.chosen)

    def __getitem__(self, places: list[int]) -> dict[str, torch.Tensor]:
        return self.frames[[self.chosen[place] for place in places]]


def _let_go(lock: Path, reader: int) -> None:  # noqa: ARG001
    """Close a reader's copy of the run's lock.

    Readers outlive a killed training by seconds, in which nobody could go on with it.
    """
    for entry in Path("/proc/self/fd").glob("*"):
        if entry.is_symlink() and os.path.realpath(entry) == str(lock.resolve()):
            os.close(int(entry.name))


class AtomicCheckpoints(CheckpointIO):
    """Lightning's checkpoints, written atomically and read as plain tensors and numbers."""

    def save_checkpoint(
        self,
        checkpoint: dict[str, Any],
        path: str | os.PathLike[str],
        storage_options: Any | None = None,  # noqa: ARG002
    ) -> None:
        file = Path(path)
        try:
            with atomic_path(file) as temporary:
                torch.save(checkpoint, temporary)
                # Before the move: a kill between the two leaves the old one, whose digest is there.
                there = [p for p in (temporary, file) if p.is_file()]
                digests = LastFiles(checkpoint=[digest_file(p) for p in there])
                write_document(file.with_name(run_files.DIGESTS), digests)
        except RuntimeError as error:  # torch's error for a full disk
            raise ToolkitError(
                f"cannot write the checkpoint: {error}",
                path=file,
                hint="the one before is kept; is the disk full?",
            ) from error

    def load_checkpoint(
        self,
        path: str | os.PathLike[str],
        map_location: Any | None = None,  # noqa: ARG002
        weights_only: bool | None = None,  # noqa: ARG002
    ) -> dict[str, Any]:
        known = run_files.read_digests(Path(path).parent).checkpoint
        if known and digest_file(Path(path)) not in known:
            raise ToolkitError(
                "was changed or damaged since it was written",
                path=Path(path),
                hint="restore the file, or delete it to restart this training",
            )
        try:
            return torch.load(path, map_location="cpu", weights_only=True)
        except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError) as error:
            raise ToolkitError(
                f"not a checkpoint of std-train: {error}",
                path=Path(path),
                hint="delete it to restart this training",
            ) from error

    def remove_checkpoint(self, path: str | os.PathLike[str]) -> None:
        Path(path).unlink(missing_ok=True)
