"""Environment maps and floor images of a folder, those for training and for testing kept apart."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from sensors.lighting.environment import SUFFIXES, EnvironmentMap, read_environment
from std_toolkit.errors import ToolkitError

Split = Literal["train", "test", "all"]
TRAIN_PERCENT = 76
"""74 of 97 maps were for training in DREDS."""


def split_of(name: str) -> Literal["train", "test"]:
    """The split of a file by its name without suffix: the same on every machine, for ever."""
    number = int(hashlib.sha256(name.encode()).hexdigest()[:8], 16) % 100
    return "train" if number < TRAIN_PERCENT else "test"


def files_of_split(folder: Path | str, split: Split, suffixes: tuple[str, ...]) -> list[Path]:
    """Files of a split, in name order.

    Sub-folders `train` and `test` decide where there are any; otherwise the names do.

    Raises:
        ToolkitError: no such folder, or it has no file for the split.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ToolkitError(
            "no such folder", path=folder, hint="leave the option out to use what is built in"
        )
    divided = [d for d in ("train", "test") if (folder / d).is_dir()]
    if divided:
        found = [p for d in divided if split in (d, "all") for p in _files(folder / d, suffixes)]
    else:
        found = [p for p in _files(folder, suffixes) if split in (split_of(p.stem), "all")]
    if not found:
        total = sum(len(_files(folder / d, suffixes)) for d in (".", *divided))
        raise ToolkitError(
            f"no {' or '.join(suffixes)} file" + (f" for the split {split}" if total else ""),
            path=folder,
            hint=f"{total} files belong to the other split; sort them into {folder.name}/train "
            f"and {folder.name}/test yourself"
            if total
            else "put files there, or leave the option out to use what is built in",
        )
    return sorted(found)


def _files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in suffixes and p.is_file())


class EnvironmentFolder:
    """Maps of a folder.

    Args:
        folder: holds .hdr and .exr files, or sub-folders `train` and `test` that do.
        split: which of them to draw from.

    Raises:
        ToolkitError: see `files_of_split`.
    """

    def __init__(self, folder: Path | str, *, split: Split = "train") -> None:
        self.files = files_of_split(folder, split, SUFFIXES)

    def draw(self, rng: np.random.Generator) -> EnvironmentMap:
        """A map at random; consumes one number.

        Raises:
            ToolkitError: the file cannot be read.
        """
        return _kept(self.files[int(rng.integers(len(self.files)))])


@lru_cache(maxsize=8)
def _kept(path: Path) -> EnvironmentMap:
    return read_environment(path)
