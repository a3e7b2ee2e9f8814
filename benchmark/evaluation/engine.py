"""The run engine: batches over workers and GPUs, resume, checks before the start.

A run's table, which grows over interruptions: what is there stays, what lacks is worked out.

Which worker process gets which GPU.

Methods of a run: told at once if they cannot be used, and named by the hash of their weights.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd

from benchmark.evaluation.manifest import MANIFEST, begin
from benchmark.evaluation.results import TABLE, good_frames, join_parts, write_part
from benchmark.methods.registry import MethodOptions, shipped_file
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import hold_lock, sweep_temporaries
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.scene.document import digest_file

# A worker that takes the place of a dead one waits until the system has freed its lock.
_PATIENCE_S = 30.0

T = TypeVar("T")

# Frames that go through a method together, by their number in the split.
Batch = tuple[int, ...]

# Pieces per worker: enough that no worker waits long for the slowest at the end.
_PIECES_PER_WORKER = 16

_LONGEST_PIECE = 64

# A killed worker loses what it has not written; a method slower than this writes every batch.
_FLUSH_S = 2.0


def check_device(name: str) -> None:
    """See that a device exists, whether or not the method will use it.

    Raises:
        ToolkitError: no device is called so, or this machine does not have it.
    """
    if name != "cpu":  # torch is not needed to know that it is there
        from benchmark.methods.network import torch_device

        torch_device(name)


@cache
def claim_device(devices: tuple[str, ...], folder: Path) -> str:
    """The device of this process until it ends; no two processes of a run get the same.

    A lock on a file per device decides, which a dead process frees by dying. One device alone is
    not locked: the run then has as many workers on it as the user asked for.

    Args:
        devices: torch devices.
        folder: where the lock files lie, one folder per run.

    Raises:
        ToolkitError: all are taken.
    """
    if len(devices) == 1:
        return devices[0]
    folder.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        for device in devices:
            if _hold(folder / f"device-{device.replace(':', '-')}.lock"):
                return device
        time.sleep(0.1)
    raise ToolkitError(
        "more worker processes than devices",
        field="--device",
        value=" ".join(devices),
        hint="--workers is the number of devices, or less",
    )


def _hold(path: Path) -> bool:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return False
    return True  # left open on purpose: the lock lives as long as the process


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


def complete(
    folder: Path,
    manifest: Any,
    remaining: Callable[[set[int]], Sequence[T]],
    worker: Callable[[T], int],
    *,
    title: str,
    key: Callable[[T], str],
    jobs: JobOptions,
    unit: str,
    table: str = TABLE,
    manifest_name: str = MANIFEST,
) -> pd.DataFrame:
    """Work out what a run's table lacks, while nobody else writes to it.

    Args:
        folder: of the run.
        manifest: what the run is; see `begin`.
        remaining: the work that is left, given the numbers of what is finished.
        worker: does one of these and writes its rows by `write_part`.
        title, key: the run and a piece of its work, for people.
        jobs: how many at a time, and where.
        unit: what the pieces of work are called, in the plural.
        table, manifest_name: names of the files.

    Returns:
        The whole table.

    Raises:
        ToolkitError: another run was begun there, somebody writes to it, or work failed; what
            was finished is kept.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(folder, "lock", doing="writing to"):
        begin(folder, manifest, manifest_name)
        sweep_temporaries(folder)
        # Joined before anything is added: the parts of this run may have the names of earlier ones.
        work = remaining(good_frames(join_parts(folder, table)))
        report = run_jobs(worker, work, name=title, key=key, options=jobs)
        whole = join_parts(folder, table)
    if report.failed:
        # The log has a line for each; here the first one, since they tend to be of one kind.
        where, why = next(iter(report.failed.items()))
        raise ToolkitError(
            f"{len(report.failed)} of {len(work)} {unit} failed; {where}: {why}",
            path=folder,
            hint="what was finished is kept; the same command goes on",
        )
    return whole


def describe_frames(piece: Sequence[Batch]) -> str:
    """A piece of work by its frames, for people.

    >>> told_frames([(0, 1), (4, 5)])
    'frames 0 to 5'
    """
    return f"frames {piece[0][0]} to {piece[-1][-1]}"


class UnusableMethod(ToolkitError):
    """A method that cannot be made with these options, whatever the data."""


@contextmanager
def as_unusable_method(devices: Sequence[str]) -> Iterator[None]:
    """What goes wrong while methods are made on these devices is an `UnusableMethod`.

    Raises:
        UnusableMethod: a device that there is not, or what a method says of its options.
    """
    try:
        for device in devices:
            check_device(device)
        yield
    except ToolkitError as error:
        raise UnusableMethod(
            error.problem, path=error.path, field=error.field, value=error.value, hint=error.hint
        ) from error


def weights_digest(name: str, method: object, options: MethodOptions) -> str:
    """SHA-256 of the file of weights that a method uses, a user's or one that comes along; empty
    where there is none.

    Args:
        name: of the method.
        method: the method itself; None where there is none, as of raw depth.
        options: what it was made with.
    """
    if method is None:
        return ""
    # A method of somebody's own may use the file without telling.
    weights = getattr(method, "weights", None) or options.weights
    if weights is None and (shipped := shipped_file(name, options.preset)).is_file():
        weights = shipped
    return digest_file(weights) if isinstance(weights, Path) else ""
