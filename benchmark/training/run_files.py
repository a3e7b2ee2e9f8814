"""Files in the folder of a training: their names, and the CSV log of losses and speed.

The log survives interruptions.
"""

import csv
import io
import time
from collections.abc import Mapping
from pathlib import Path

from std_toolkit.io.atomic import write_bytes_atomic

BEST = "best.safetensors"  # the weights with the best validation

SCORES = "best.json"  # its step and scores

LAST = "last.safetensors"  # the weights after the last step: written when a training ends

CHECKPOINT = "last.ckpt"  # what a resumed training needs


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
            with path.open(newline="", encoding="utf-8") as file:
                self.rows = [row for row in csv.DictReader(file) if int(row["step"]) <= step]

    def add(self, row: Mapping[str, float | int | str]) -> None:
        """Add a row; it has `step`."""
        self.rows.append({name: _text(value) for name, value in row.items()})

    def save(self) -> None:
        """Write all rows, atomically."""
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        text = io.StringIO()
        writer = csv.DictWriter(text, names, lineterminator="\n", restval="")
        writer.writeheader()
        writer.writerows(self.rows)
        write_bytes_atomic(self.path, text.getvalue().encode())


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
