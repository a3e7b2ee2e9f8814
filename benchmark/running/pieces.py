"""Cutting a run into pieces of work, and reading ahead within one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

# Frames that go through a method together, by their number in the split.
Batch = tuple[int, ...]

# Pieces per worker: enough that no worker waits long for the slowest at the end.
_PIECES_PER_WORKER = 16
_LONGEST_PIECE = 64


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


def read_ahead(batches: Sequence[Batch], read: Callable[[Batch], T]) -> Iterator[tuple[Batch, T]]:
    """Batches with what `read` makes of them; the next is read while this one is worked on."""
    with ThreadPoolExecutor(1) as reader:
        coming = reader.submit(read, batches[0])
        for place, batch in enumerate(batches):
            loaded = coming.result()
            if place + 1 < len(batches):
                coming = reader.submit(read, batches[place + 1])
            yield batch, loaded
