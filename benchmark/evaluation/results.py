"""Results of runs: Parquet parts while a run grows, runs found again, text for the terminal.

A part appears whole or not at all, and names the frames that it holds, so that a run which was
killed knows what it has. At the end all are joined into one table in the order of the frames.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import pandas as pd

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path
from std_toolkit.log import logger

TABLE = "images.parquet"

FAILURES = "failures.csv"

PARTS = "parts"

_NAME = re.compile(r"(\d{7})-(\d{7})\.parquet")

# Columns that every row has; those of the protocol's metrics follow.
INDEX, SCENE, FRAME = "index", "scene", "frame"

ERROR = "error"  # why the frame or the method failed; empty where neither did

NOT_FINITE = "not_finite"  # pixels of the answer that are NaN or infinite

# What a frame has that could not be read: no grid, and whole numbers so that the columns keep
# their type.
UNREAD = {NOT_FINITE: 0, "grid": "", "subset": "", "n_pixels": 0, "n_answered": 0}


def write_part(folder: Path, first: int, last: int, rows: Sequence[dict[str, Any]]) -> None:
    """Write the rows of frames `first` to `last` (both included) of the split.

    Raises:
        ToolkitError: the file cannot be written.
    """
    with atomic_path(folder / PARTS / f"{first:07d}-{last:07d}.parquet") as temporary:
        pd.DataFrame(list(rows)).to_parquet(temporary, index=False)


def read_table(path: Path) -> pd.DataFrame:
    """A Parquet table of ours.

    Raises:
        ToolkitError: it cannot be read.
    """
    try:
        return pd.read_parquet(path)
    except Exception as error:  # pyarrow raises OSError, ValueError and classes of its own
        raise ToolkitError(
            f"cannot read the table: {' '.join(str(error).split())[:200]}",
            path=path,
            hint="delete it and run the same command again",
        ) from error


def check_columns(table: pd.DataFrame, needed: Iterable[str], path: Path) -> None:
    """See that a table read from a file has some columns.

    Raises:
        ToolkitError: it has not.
    """
    if absent := [name for name in needed if name not in table]:
        raise ToolkitError("the table lacks columns", path=path, field=", ".join(absent))


def good_frames(table: pd.DataFrame) -> set[int]:
    """Frames of the split that need not be scored again; those that failed are tried again."""
    return set(table.loc[table[ERROR] == "", INDEX].tolist())


def join_parts(folder: Path, name: str = TABLE) -> pd.DataFrame:
    """Join all parts with the table of earlier runs, and write table `name` and `failures.csv`.

    The table is the same however the frames came to be spread over parts.

    Returns:
        The rows of all frames. A frame that could not be read has one, without grid and figures.

    Raises:
        ToolkitError: a part cannot be read, or the table not be written.
    """
    paths = sorted(p for p in (folder / PARTS).glob("*.parquet") if _NAME.fullmatch(p.name))
    earlier = [folder / name] if (folder / name).exists() else []
    table = _newest([read_table(path) for path in (*earlier, *paths)])
    if paths:
        with atomic_path(folder / name) as temporary:
            table.to_parquet(temporary, index=False)
        failed = table[table[ERROR] != ""]
        with atomic_path(folder / FAILURES) as temporary:
            told = failed[[INDEX, SCENE, FRAME, ERROR]].drop_duplicates()
            told.to_csv(temporary, index=False)
        for path in paths:
            path.unlink()
    return table


def _newest(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """One table in the order of the frames; a frame's later rows take the place of earlier ones."""
    if not tables:
        return pd.DataFrame({INDEX: [], SCENE: [], FRAME: [], ERROR: []})
    joined = pd.concat(tables, ignore_index=True)
    place = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    # A frame that succeeded is not thrown away for a later failure.
    worth = pd.Series(place + len(tables) * (joined[ERROR] == "").to_numpy())
    kept = joined[worth == worth.groupby(joined[INDEX]).transform("max")]
    # Stable: the rows of one frame keep the order in which the protocol gave them.
    return kept.sort_values(INDEX, kind="stable", ignore_index=True)


def report_failures(table: pd.DataFrame, title: str, folder: Path) -> int:
    """Number of frames of a run that failed; if there are any, the log says where they stand."""
    failed = table[table[ERROR] != ""]
    if failed.empty:
        return 0
    count = int(failed[INDEX].nunique())
    logger.warning(
        "%s: %d frames failed, the first with: %s; all in %s",
        title, count, failed[ERROR].iloc[0], folder / FAILURES,
    )  # fmt: skip
    return count


M = TypeVar("M", bound=Any)


@dataclass(frozen=True, eq=False)
class Result(Generic[M]):
    """One run, read back.

    Attributes:
        folder: where it lies.
        manifest: what it was.
        table: its rows.
    """

    folder: Path
    manifest: M
    table: pd.DataFrame

    @property
    def title(self) -> str:
        """What it is among others; two results of one title are one run, or a mistake."""
        raise NotImplementedError

    @property
    def frames(self) -> int:
        """Frames that the run has."""
        return int(self.manifest.setup.frames)

    @property
    def missing(self) -> int:
        """Frames that the run has not come to: it was interrupted, or a worker failed."""
        return self.frames - int(self.table[INDEX].nunique())


Found = TypeVar("Found", bound=Result[Any])


def find_runs(
    folders: Iterable[Path], manifest: str, table: str, read: Callable[[Path], Found]
) -> list[Found]:
    """All finished runs of a task below some folders of results.

    Args:
        folders: of results.
        manifest, table: files of a run of this task.
        read: makes a result of a run's folder.

    Raises:
        ToolkitError: a folder is not there or holds none, a run is damaged, or two runs of one
            title are among them.
    """
    found: dict[str, Found] = {}
    for folder in folders:
        begun = sorted(path.parent for path in folder.rglob(manifest))
        finished = [path for path in begun if (path / table).exists()]
        if not finished:
            problem = "no finished run here" + ("" if begun else ", no results of std-bench at all")
            hint = "run the same std-bench command again to go on" if begun else None
            raise ToolkitError(problem, path=folder, hint=hint)
        for path in begun:
            if path not in finished:
                logger.warning("%s: not finished, left out", path)
        for path in finished:
            result = read(path)
            other = found.setdefault(result.title, result)
            if other.folder.resolve() != path.resolve():
                raise ToolkitError(
                    f"{result.title} stands in two folders",
                    path=path,
                    value=str(other.folder),
                    hint="give one of them another name with --label",
                )
            if result.missing:
                logger.warning(
                    "%s: not finished: %d of %d frames are missing",
                    path, result.missing, result.frames,
                )  # fmt: skip
    return list(found.values())
