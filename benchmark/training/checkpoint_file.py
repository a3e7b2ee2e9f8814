"""Checkpoints on disk: whole or not there, and read without running code."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import torch
from pytorch_lightning.plugins import CheckpointIO

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path


class AtomicCheckpoints(CheckpointIO):
    """Lightning's checkpoints, written atomically and read as plain tensors and numbers."""

    def save_checkpoint(
        self,
        checkpoint: dict[str, Any],
        path: str | os.PathLike[str],
        storage_options: Any | None = None,  # noqa: ARG002
    ) -> None:
        try:
            with atomic_path(Path(path)) as temporary:
                torch.save(checkpoint, temporary)
        except RuntimeError as error:  # how torch tells of a full disk
            raise ToolkitError(
                f"cannot write the checkpoint: {error}",
                path=Path(path),
                hint="the one before is kept; is the disk full?",
            ) from error

    def load_checkpoint(
        self,
        path: str | os.PathLike[str],
        map_location: Any | None = None,  # noqa: ARG002
        weights_only: bool | None = None,  # noqa: ARG002
    ) -> dict[str, Any]:
        try:
            return torch.load(path, map_location="cpu", weights_only=True)
        except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError) as error:
            raise ToolkitError(
                f"not a checkpoint of std-train: {error}",
                path=Path(path),
                hint="delete it to begin this training anew",
            ) from error

    def remove_checkpoint(self, path: str | os.PathLike[str]) -> None:
        Path(path).unlink(missing_ok=True)
