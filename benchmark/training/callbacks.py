"""Callbacks of a training: validation, pictures, checkpoints, logs."""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytorch_lightning as pl
import torch
from torch.utils.tensorboard import SummaryWriter

from benchmark.methods.weights import save_weights
from benchmark.training.module import RestorerTraining
from benchmark.training.run_files import BEST, CHECKPOINT, SCORES, BestScores, Rows, Speed
from benchmark.training.step import BATCH_NORM_FRAMES
from benchmark.training.validation import Validator
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_file, write_document
from std_toolkit.log import logger


class Watch(pl.Callback):
    """Validates, keeps the best weights, saves checkpoints and writes the logs.

    Lightning's epochs are here the steps from one checkpoint to the next, so that a checkpoint
    never stands within one.

    Args:
        folder: of the run.
        validator: validation.
        log_every: steps.
    """

    def __init__(self, folder: Path, validator: Validator, *, log_every: int) -> None:
        self.folder, self.validator, self.log_every = folder, validator, log_every
        self.best, self.best_step = math.inf, -1
        self.speed = Speed()

    def state_dict(self) -> dict[str, Any]:
        return {"best": self.best, "best_step": self.best_step}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.best, self.best_step = state_dict["best"], state_dict["best_step"]

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        step = trainer.global_step
        self.steps = Rows(self.folder / "steps.csv", step)
        self.validations = Rows(self.folder / "validation.csv", step)
        self.board = None
        if trainer.is_global_zero:
            threading.excepthook = _ignore_until_next_write
            self.board = SummaryWriter(str(self.folder / "tensorboard"), purge_step=step + 1)
        if step:
            logger.info("going on from step %d", step)

    def on_train_epoch_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        self.speed.restart()

    def on_train_batch_start(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        self.speed.begin_step()

    def on_train_batch_end(
        self,
        trainer: pl.Trainer,
        pl_module: RestorerTraining,  # type: ignore[override]
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        self.speed.end_step(len(batch["index"]) * trainer.world_size)
        step = trainer.global_step
        ended = (batch_idx + 1) % pl_module.config.accumulate == 0
        if not ended or not trainer.is_global_zero:
            return
        if step % self.log_every == 0 or step in (1, pl_module.config.steps):
            config = pl_module.config
            row = {"step": step, "learning_rate": config.rate(step - 1)}
            row |= {name: float(part) for name, part in pl_module.parts.items()}
            row |= self.speed.figures()
            phase = {"phase": config.step_info(step - 1).phase} if config.phases else {}
            self.steps.add({**row, **phase})
            self._show("train", row)

    def on_train_epoch_end(
        self,
        trainer: pl.Trainer,
        pl_module: RestorerTraining,  # type: ignore[override]
    ) -> None:
        step, config = trainer.global_step, pl_module.config
        if step % config.validate_every == 0 or step == config.steps:
            self._validate(trainer, pl_module)
        if trainer.is_global_zero:
            self.steps.save()
        # Last: what it says to be done is done.
        trainer.save_checkpoint(self.folder / CHECKPOINT)

    def on_train_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        self._close()

    def on_exception(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, exception: BaseException
    ) -> None:
        with suppress(ToolkitError):  # it must not hide what went wrong first
            self._close()

    def _validate(self, trainer: pl.Trainer, module: RestorerTraining) -> None:
        network, device, step = module.network, module.device, trainer.global_step
        if module.config.batch_norm == "recomputed":
            frames = trainer.datamodule.first(BATCH_NORM_FRAMES)  # type: ignore[attr-defined]  # Loaders
            module.recompute_batch_norm(frames)
        states = self.validator.states(
            network,
            device,
            rank=trainer.global_rank,
            world=trainer.world_size,
            context=trainer.precision_plugin.forward_context,
        )
        if trainer.world_size > 1:
            summed = torch.from_numpy(states).to(device)
            torch.distributed.all_reduce(summed)
            states = summed.cpu().numpy()
        scores = self.validator.scores(states)
        name, score = self.validator.main_score(scores)
        better = score < self.best or self.best_step < 0
        if better:
            self.best, self.best_step = score, step
        if not trainer.is_global_zero:
            return
        self.validations.add({"step": step, **scores})
        self.validations.save()
        self._show("validation", {"step": step, **scores})
        self.validator.gallery(network, device, self.folder / "gallery" / f"step-{step:07d}.jpg")
        if better:
            save_weights(network, self.folder / BEST)
            known: dict[str, float | None] = {
                key: value for key, value in scores.items() if not math.isnan(value)
            }
            digest = digest_file(self.folder / BEST)
            row = BestScores(step=step, ranked_by=name, scores=known, weights=digest)
            write_document(self.folder / SCORES, row)
        logger.info(
            "step %d: %s %.4f%s; %.1f samples/s, %.0f %% of the time waiting for data",
            step,
            name,
            score,
            ", the best so far" if better else f" (best {self.best:.4f} at step {self.best_step})",
            self.speed.figures()["samples_per_s"],
            100 * self.speed.figures()["waiting_for_data"],
        )

    def _show(self, group: str, row: dict[str, Any]) -> None:
        if self.board is not None:
            with self._writing_board():
                for name, value in row.items():
                    if name != "step" and not math.isnan(value):
                        self.board.add_scalar(f"{group}/{name}", value, row["step"])

    def _close(self) -> None:
        if getattr(self, "board", None) is not None:
            try:
                with self._writing_board():
                    self.board.close()  # type: ignore[union-attr]
            finally:
                self.board = None
                threading.excepthook = threading.__excepthook__

    @contextmanager
    def _writing_board(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:  # without the name of the file
            raise ToolkitError(
                f"cannot write the log: {error.strerror or error}",
                path=self.folder / "tensorboard",
                hint="the last checkpoint is kept; the same command goes on from it",
            ) from error


def _ignore_until_next_write(failure: Any) -> None:
    """What fails in TensorBoard's thread is raised at the next write, and needs no traceback."""
    if type(failure.thread).__name__ != "_AsyncWriterThread":
        threading.__excepthook__(failure)
