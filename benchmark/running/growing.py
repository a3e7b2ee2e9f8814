"""A run's table, which grows over interruptions: what is there stays, what lacks is worked out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd

from benchmark.running.manifest import MANIFEST, begin
from benchmark.running.parts import TABLE, good_frames, join_parts
from benchmark.running.pieces import Batch
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.scene.lock import hold_lock

T = TypeVar("T")


def complete(
    folder: Path,
    manifest: Any,
    lacking: Callable[[set[int]], Sequence[T]],
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
        lacking: the work that is left, given the numbers of what is finished.
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
        work = lacking(good_frames(join_parts(folder, table)))
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


def told_frames(piece: Sequence[Batch]) -> str:
    """A piece of work by its frames, for people.

    >>> told_frames([(0, 1), (4, 5)])
    'frames 0 to 5'
    """
    return f"frames {piece[0][0]} to {piece[-1][-1]}"
