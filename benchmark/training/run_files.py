"""Files in the folder of a training: their names, and the CSV log of losses and speed.

The log survives interruptions.
"""

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_csv_atomic
from std_toolkit.io.documents import digest_file, read_document
from std_toolkit.io.foreign_files import csv_rows
from std_toolkit.io.regular import read_text

_LARGEST_LOG_BYTES = 256 * 2**20  # of a million steps
BEST = "best.safetensors"  # the weights with the best validation

SCORES = "best.json"  # its step and scores

LAST = "last.safetensors"  # the weights after the last step: written when a training ends


class BestScores(msgspec.Struct, frozen=True, kw_only=True):
    """`best.json`: the step of the best weights, and the scores of its validation by name.

    Attributes:
        ranked_by: name of the score that decided.
        weights: digest of the weights; empty in trainings of 0.1.0.
    """

    step: Annotated[int, msgspec.Meta(ge=0)]
    ranked_by: str = ""
    scores: dict[str, float | None]
    weights: str = ""


CHECKPOINT = "last.ckpt"  # what a resumed training needs

DIGESTS = "digests.json"  # of both


class LastFiles(msgspec.Struct, frozen=True, kw_only=True):
    """`digests.json`: what `last.ckpt` and `last.safetensors` must hold.

    Attributes:
        checkpoint: digests of the checkpoint, the newest first: that of the one before stands as
            long as a kill may leave it in place.
        weights: digest of the weights; empty before the training ends.
    """

    checkpoint: list[str] = msgspec.field(default_factory=list)
    weights: str = ""


def read_digests(run: Path) -> LastFiles:
    """`digests.json` of a training; empty if there is none, as in trainings of 0.1.0."""
    path = run / DIGESTS
    return read_document(path, LastFiles) if path.is_file() else LastFiles()


def is_trained(run: Path) -> bool:
    """Whether a training ended and its last weights are as written; those are made again else."""
    if not all((run / name).is_file() for name in (BEST, LAST)):
        return False
    weights = read_digests(run).weights
    return not weights or digest_file(run / LAST) == weights


def read_best(run: Path) -> BestScores:
    """`best.json` of a training, whose weights are those that it was written for.

    Raises:
        ToolkitError: no such document, or `best.safetensors` was changed or damaged since.
    """
    best = read_document(run / SCORES, BestScores)
    if best.weights and digest_file(run / BEST) != best.weights:
        raise ToolkitError(
            f"was changed or damaged since {SCORES} was written",
            path=run / BEST,
            hint="restore the file, or train again in another folder",
        )
    return best


def read_log(path: Path, *, numbers: Sequence[str] = ("step",)) -> list[dict[str, str]]:
    """Rows of a log by column.

    Args:
        numbers: columns that must hold finite numbers; the first holds whole ones.

    Raises:
        ToolkitError: unreadable, no table, or a value that is no such number; names the row.
    """
    lines = read_text(path, "table", _LARGEST_LOG_BYTES).splitlines()
    head, *rows = csv_rows(lines, path) if lines else [[]]
    found = [dict(zip(head, row, strict=False)) for row in rows]
    for number, row in enumerate(found, start=2):
        for name in numbers:
            text = row.get(name, "")
            try:
                good = math.isfinite(int(text) if name == numbers[0] else float(text))
            except (ValueError, OverflowError):
                good = False
            if not good:
                field = f"line {number}: {name}"
                raise ToolkitError("is no number", path=path, field=field, value=text)
    return found


class Rows:
    """A CSV file of rows by step.

    Args:
        path: the file; rows of it that an interrupted training left beyond `step` are dropped,
            because those steps are done again.
        step: where training stands.
    """

    def __init__(self, path: Path, step: int) -> None:
        self.path = path
        self.rows: list[dict[str, str]] = []
        if path.exists():
            self.rows = [row for row in read_log(path) if int(row["step"]) <= step]

    def add(self, row: Mapping[str, float | int | str]) -> None:
        """Add a row; it has `step`."""
        self.rows.append({name: _text(value) for name, value in row.items()})

    def save(self) -> None:
        """Write all rows, atomically."""
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        write_csv_atomic(self.path, names, self.rows)


class Speed:
    """Samples per second, and the share of the time that the network waits for data."""

    def __init__(self) -> None:
        self.samples, self.seconds, self.waiting = 0, 0.0, 0.0
        self._mark = time.perf_counter()

    def restart(self) -> None:
        """Time up to now counts for nothing: validation, checkpoints."""
        self._mark = time.perf_counter()

    def begin_step(self) -> None:
        """The data is there."""
        now = time.perf_counter()
        self.waiting += now - self._mark
        self.seconds += now - self._mark
        self._mark = now

    def end_step(self, samples: int) -> None:
        """The network is done with it."""
        now = time.perf_counter()
        self.seconds += now - self._mark
        self.samples += samples
        self._mark = now

    def figures(self) -> dict[str, float]:
        """Figures since the beginning."""
        seconds = max(self.seconds, 1e-9)
        return {
            "samples_per_s": self.samples / seconds,
            "waiting_for_data": self.waiting / seconds,
        }


def _text(value: float | int | str) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
