"""Cutting a run into pieces of work, and working through one: reading ahead, writing as it goes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from benchmark.running.parts import write_part

T = TypeVar("T")

# Frames that go through a method together, by their number in the split.
Batch = tuple[int, ...]

# Pieces per worker: enough that no worker waits long for the slowest at the end.
_PIECES_PER_WORKER = 16
_LONGEST_PIECE = 64
# A killed worker loses what it has not written; a method slower than this writes every batch.
_FLUSH_S = 2.0


def chosen_frames(total: int, limit: int | None) -> list[int]:
    """Frames of a split that a run takes: all, or `limit` of them evenly spread.

    >>> chosen_frames(10, 2)
    [2, 7]
    """
    if limit is None or limit >= total:
        return list(range(total))
    return [(2 * i + 1) * total // (2 * limit) for i in range(limit)]


def batches_of(frames: Sequence[int], size: int) -> list[Batch]:
    """Frames in batches.

    >>> batches_of([0, 1, 4, 5, 6], 2)
    [(0, 1), (4, 5), (6,)]
    """
    return [tuple(frames[i : i + size]) for i in range(0, len(frames), size)]


def pieces_of(batches: Sequence[Batch], workers: int) -> list[tuple[Batch, ...]]:
    """Batches in pieces of work."""
    each = max(1, min(_LONGEST_PIECE, len(batches) // (workers * _PIECES_PER_WORKER)))
    return [tuple(batches[i : i + each]) for i in range(0, len(batches), each)]


def pieces_left(
    frames: Sequence[int], size: int, workers: int, done: set[int]
) -> list[tuple[Batch, ...]]:
    """Pieces of work of the batches of frames that are not finished to the last frame."""
    left = [batch for batch in batches_of(frames, size) if not done.issuperset(batch)]
    return pieces_of(left, workers)


def read_ahead(batches: Sequence[Batch], read: Callable[[Batch], T]) -> Iterator[tuple[Batch, T]]:
    """Batches with what `read` makes of them; the next is read while this one is worked on."""
    with ThreadPoolExecutor(1) as reader:
        coming = reader.submit(read, batches[0])
        for place, batch in enumerate(batches):
            loaded = coming.result()
            if place + 1 < len(batches):
                coming = reader.submit(read, batches[place + 1])
            yield batch, loaded


def write_rows(
    folder: Path,
    batches: Sequence[Batch],
    read: Callable[[Batch], T],
    rows_of: Callable[[Batch, T], list[dict[str, Any]]],
) -> int:
    """Write the rows of a piece of work as parts of a table, as they come.

    Args:
        folder: of the run.
        batches: the piece.
        read: what of a batch can be read ahead.
        rows_of: the rows of a batch, with what was read.

    Returns:
        How many frames there were.
    """
    rows: list[dict[str, Any]] = []
    pending: list[Batch] = []

    def flush() -> None:
        write_part(folder, pending[0][0], pending[-1][-1], rows)
        rows.clear()
        pending.clear()

    since = time.monotonic()
    for batch, loaded in read_ahead(batches, read):
        rows += rows_of(batch, loaded)
        pending.append(batch)
        if time.monotonic() - since > _FLUSH_S:
            flush()
            since = time.monotonic()
    if pending:
        flush()
    return sum(len(batch) for batch in batches)
