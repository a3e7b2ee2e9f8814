"""Frames of a run in batches, and batches in the pieces that workers take."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from benchmark.evaluation.results import write_part

T = TypeVar("T")

# Frames that are passed to a method together, by their index in the split.
Batch = tuple[int, ...]

# Pieces per worker: enough that no worker waits long for the slowest at the end.
_PIECES_PER_WORKER = 16

_LONGEST_PIECE = 64

# A killed worker loses what it has not written; a method slower than this writes every batch.
_FLUSH_S = 2.0


def chosen_frames(total: int, limit: int | None) -> list[int]:
    """Return the frames of a split that a run uses: all, or `limit` of them evenly spaced.

    >>> chosen_frames(10, 2)
    [2, 7]
    """
    if limit is None or limit >= total:
        return list(range(total))
    return [(2 * i + 1) * total // (2 * limit) for i in range(limit)]


def batches_of(frames: Sequence[int], size: int) -> list[Batch]:
    """Split frames into batches.

    >>> batches_of([0, 1, 4, 5, 6], 2)
    [(0, 1), (4, 5), (6,)]
    """
    return [tuple(frames[i : i + size]) for i in range(0, len(frames), size)]


def pieces_of(batches: Sequence[Batch], workers: int) -> list[tuple[Batch, ...]]:
    """Group batches into pieces, the work items."""
    each = max(1, min(_LONGEST_PIECE, len(batches) // (workers * _PIECES_PER_WORKER)))
    return [tuple(batches[i : i + each]) for i in range(0, len(batches), each)]


def pieces_left(
    frames: Sequence[int], size: int, workers: int, done: set[int]
) -> list[tuple[Batch, ...]]:
    """Return pieces of the batches that have at least one unfinished frame."""
    left = [batch for batch in batches_of(frames, size) if not done.issuperset(batch)]
    return pieces_of(left, workers)


def read_ahead(batches: Sequence[Batch], read: Callable[[Batch], T]) -> Iterator[tuple[Batch, T]]:
    """Yield each batch with the result of `read`; the next batch is read in the background."""
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
    """Write the rows of a piece as parts of a table, as they are computed.

    Args:
        folder: folder of the run.
        batches: the piece.
        read: reads the data of a batch; called ahead.
        rows_of: returns the rows of a batch, given the data read.

    Returns:
        The number of frames.
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


def describe_frames(piece: Sequence[Batch]) -> str:
    """Return the title of a piece in messages.

    >>> describe_frames([(0, 1), (4, 5)])
    'frames 0 to 5'
    """
    return f"frames {piece[0][0]} to {piece[-1][-1]}"
