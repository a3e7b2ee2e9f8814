"""Results of runs: writing and joining Parquet parts, and finding finished runs.

A part is written atomically and its name gives its frames, so that a killed run can resume. At the
end all parts are joined into one table in the order of the frames.
"""

import re
from collections.abc import Callable, Iterable, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import numpy as np
import pandas as pd

from benchmark.data.identity import COLUMNS
from benchmark.evaluation.known_data import (
    CONTENT_FILE,
    DATA_FILE,
    DataRecord,
    KnownData,
    names_of_data,
    published_size,
)
from benchmark.evaluation.submission import Submission
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.documents import read_document
from std_toolkit.log import logger

TABLE = "images.parquet"

FAILURES = "failures.csv"

PARTS = "parts"

_NAME = re.compile(r"(\d{7})-(\d{7})\.parquet")

# Columns of every row; the columns of the protocol's metrics follow.
INDEX, SCENE, FRAME = "index", "scene", "frame"

# Columns of text; all others hold numbers.
_TEXTS = {
    SCENE, FRAME, "content", "digest", "error", "grid", "subset", "kind", "fate", "outcome",
    "model", "tuples", "layer",
}  # fmt: skip

_LONGEST_NAME = 1000

_AGAIN = "delete it and run the same command again"

ERROR = "error"  # why the frame or the method failed; empty otherwise

NOT_FINITE = "not_finite"  # pixels of the prediction that are NaN or infinite

# Columns of counts in any table; others hold -1 where a row has none.
_COUNTS = (INDEX, NOT_FINITE, "n_pixels", "n_answered", "pixels", "held", "lost", "asked", "right",
           "left_out")  # fmt: skip

# Columns of a frame that could not be read: no grid, and integers so that the columns keep their
# type.
UNREAD = {NOT_FINITE: 0, "grid": "", "subset": "", "n_pixels": 0, "n_answered": 0}


def write_part(folder: Path, first: int, last: int, rows: Sequence[dict[str, Any]]) -> None:
    """Write the rows of frames `first` to `last` (both included) of the split.

    Raises:
        ToolkitError: the file cannot be written.
    """
    with atomic_path(folder / PARTS / f"{first:07d}-{last:07d}.parquet") as temporary:
        pd.DataFrame(list(rows)).to_parquet(temporary, index=False, write_page_checksum=True)


def read_table(path: Path) -> pd.DataFrame:
    """Read a Parquet table of a run.

    Raises:
        ToolkitError: it cannot be read, or a column of text holds something else.
    """
    try:
        table = pd.read_parquet(path, page_checksum_verification=True)
    except Exception as error:  # pyarrow raises OSError, ValueError and classes of its own
        raise ToolkitError(
            f"cannot read the table: {' '.join(str(error).split())[:200]}",
            path=path,
            hint=_AGAIN,
        ) from error
    for name in _TEXTS & {*table}:
        column = table[name]
        if not isinstance(column.dtype, pd.StringDtype):
            wrong = (v for v in column[column.notna()] if not isinstance(v, str))
            if (value := next(wrong, None)) is not None:
                raise ToolkitError(
                    "the column needs text", path=path, field=name, value=str(value)[:40],
                    hint=_AGAIN,
                )  # fmt: skip
    return table


def check_rows_once(table: pd.DataFrame, path: Path) -> None:
    """Check that no row is there twice; a pose that was found twice may be.

    Raises:
        ToolkitError: two rows are equal.
    """
    twice = table.duplicated()
    if twice.any():
        row = f"row {twice.idxmax()}"
        raise ToolkitError("a row is there twice", path=path, field=row, hint=_AGAIN)


def read_known(folder: Path) -> KnownData:
    """Read what a run knows of its data.

    Raises:
        ToolkitError: a file is damaged.
    """
    path = folder / DATA_FILE
    if not path.exists():
        return KnownData()
    content = read_table(folder / CONTENT_FILE)
    check_columns(content, COLUMNS, folder / CONTENT_FILE)
    return KnownData(read_document(path, DataRecord), content)


def check_columns(table: pd.DataFrame, needed: Iterable[str], path: Path) -> None:
    """Check that a table read from a file has the needed columns, and numbers where they belong.

    Raises:
        ToolkitError: columns are missing, hold text instead of numbers, names with control
            characters or angle brackets, which would be markup on a page, or counts below 0.
    """
    needed = list(needed)
    if absent := [name for name in needed if name not in table]:
        raise ToolkitError("the table lacks columns", path=path, field=", ".join(absent))
    counts = [name for name in _COUNTS if name in table]
    for name in dict.fromkeys([*needed, *counts]):
        column = table[name]
        if name in _TEXTS - {ERROR}:
            strange = (v for v in column.unique() if isinstance(v, str) and not _is_name(v))
            if (value := next(strange, None)) is not None:
                raise ToolkitError("not a name", path=path, field=name, value=repr(value)[:80])
        if name in _TEXTS or column.isna().all() or pd.api.types.is_numeric_dtype(column):
            continue
        wrong = next(v for v in column if v is not None and not isinstance(v, int | float))
        raise ToolkitError("the column needs numbers", path=path, field=name, value=str(wrong)[:40])
    for name in counts:
        below = table[name][~((table[name] >= 0) & (table[name] % 1 == 0))]
        if len(below):
            raise ToolkitError(
                "a count is a whole number, 0 or more", path=path,
                field=f"{name} of row {below.index[0]}", value=float(below.iloc[0]), hint=_AGAIN,
            )  # fmt: skip


def _is_name(text: str) -> bool:
    return len(text) <= _LONGEST_NAME and text.isprintable() and not set("<>") & set(text)


def good_frames(table: pd.DataFrame) -> set[int]:
    """Return the scored frames of the split; failed frames are not among them."""
    return set(table.loc[table[ERROR] == "", INDEX].tolist())


def join_parts(folder: Path, name: str = TABLE) -> pd.DataFrame:
    """Join all parts with the table of earlier runs, and write table `name` and `failures.csv`.

    The table does not depend on how the frames are divided into parts.

    Returns:
        The rows of all frames. A frame that could not be read has one row without grid and
        figures.

    Raises:
        ToolkitError: a part cannot be read, or the table cannot be written.
    """
    paths = sorted(p for p in (folder / PARTS).glob("*.parquet") if _NAME.fullmatch(p.name))
    earlier = [folder / name] if (folder / name).exists() else []
    table = _newest([read_table(path) for path in (*earlier, *paths)])
    if paths:
        with atomic_path(folder / name) as temporary:
            table.to_parquet(temporary, index=False, write_page_checksum=True)
        failed = table[table[ERROR] != ""]
        with atomic_path(folder / FAILURES) as temporary:
            failures = failed[[INDEX, SCENE, FRAME, ERROR]].drop_duplicates()
            failures.to_csv(temporary, index=False)
        for path in paths:
            path.unlink()
    return table


def drop_frames(folder: Path, name: str, table: pd.DataFrame, frames: Set[int]) -> pd.DataFrame:
    """Remove the rows of some frames from table `name`, whose parts are joined.

    Returns:
        The other rows.

    Raises:
        ToolkitError: the table cannot be written.
    """
    kept = table[~table[INDEX].isin(frames)].reset_index(drop=True)
    if (folder / name).exists():
        with atomic_path(folder / name) as temporary:
            kept.to_parquet(temporary, index=False, write_page_checksum=True)
    return kept


def _newest(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """One table in the order of the frames; later rows of a frame replace earlier ones."""
    if not tables:
        return pd.DataFrame({INDEX: [], SCENE: [], FRAME: [], ERROR: []})
    joined = pd.concat(tables, ignore_index=True)
    place = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    # A later failure does not replace a success.
    worth = pd.Series(place + len(tables) * (joined[ERROR] == "").to_numpy())
    kept = joined[worth == worth.groupby(joined[INDEX]).transform("max")]
    # Stable: the rows of a frame keep the order of the protocol.
    return kept.sort_values(INDEX, kind="stable", ignore_index=True)


def report_failures(table: pd.DataFrame, title: str, folder: Path) -> int:
    """Return the number of failed frames of a run; if any, log the path of their list."""
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
    """Results of one run.

    Attributes:
        folder: folder of the run.
        manifest: its manifest.
        table: its rows.
        data: what the run knows of its data.
        said: what the author of predictions in a folder says of them, if anything.
        place: name of the data set on pages; set by `find_runs`, for which content counts.
    """

    folder: Path
    manifest: M
    table: pd.DataFrame
    data: KnownData = field(default_factory=KnownData, kw_only=True)
    said: Submission | None = field(default=None, kw_only=True)
    place: str = field(default="", kw_only=True)

    @property
    def training_data(self) -> str:
        """What the method was trained on, as the run or the author says; "" if nobody does."""
        known = getattr(self.manifest, "training_data", "")
        return known or (self.said.training_data if self.said else "")

    @property
    def named(self) -> str:
        """Name of the data set on pages if there is one of this name."""
        return self.data.named(getattr(self.manifest.setup, "split", ""))

    def at(self, place: str) -> Self:
        """Return the result with the name of its data set, also in the table's column `split`."""
        table = self.table.assign(split=place) if "split" in self.table else self.table
        return replace(self, place=place, table=table)

    @property
    def title(self) -> str:
        """Unique title; two results with one title are the same run, or an error."""
        raise NotImplementedError

    @property
    def frames(self) -> int:
        """Number of frames of the run."""
        return int(self.manifest.setup.frames)

    @property
    def missing(self) -> int:
        """Number of frames without rows: the run was interrupted, or a worker failed."""
        return self.frames - int(self.table[INDEX].nunique())

    @property
    def failed(self) -> int:
        """Number of frames that could not be read, or at which the method failed."""
        return int(self.table.loc[self.table[ERROR] != "", INDEX].nunique())

    @property
    def failed_everywhere(self) -> bool:
        """Whether the method failed at every frame: it then has no figures."""
        return 0 < self.failed == self.frames - self.missing


FAILED = "failed"  # in the place of figures

Found = TypeVar("Found", bound=Result[Any])


def unanswered(results: Iterable[Result[Any]]) -> dict[str, int]:
    """Return how many frames each result of one data set has no answer to, by title.

    Frames are those of the result with the most; others may have been run on fewer, or stopped.
    """
    every = list(results)
    most = max((r.frames for r in every), default=0)
    return {r.title: most - r.frames + r.missing + r.failed for r in every}


def counted(results: Iterable[Result[Any]], frames: int | None = None) -> str:
    """Return the number of frames of results of one data set, and where the frames come from.

    Args:
        results: at least one.
        frames: their number; by default the largest number of scored ones.
    """
    every = list(results)
    if frames is None:
        frames = max(r.frames - r.missing for r in every)
    known = every[0].data
    if known.provenance.kind == "published":
        there = published_size(every[0].manifest.setup.split)
    else:
        there = max((r.data.record.frames for r in every if r.data.record), default=frames)
    many = "" if frames == 1 else "s"
    text = f"{frames:,} frame{many}" if frames >= there else f"{frames:,} of {there:,} frames"
    return text if known.provenance.kind == "published" else f"{text}, {known.origin}"


def finished_folders(folder: Path, manifest: str, table: str) -> list[Path]:
    """Return the folders of finished runs below a folder of results; others are named.

    Args:
        folder: of results.
        manifest, table: file names of a run of this task.
    """
    finished, begun = _runs_below(folder, manifest, table)
    _name_unfinished(begun)
    return finished


def _runs_below(folder: Path, manifest: str, table: str) -> tuple[list[Path], list[Path]]:
    """Folders of the runs that are finished, and of those that are only begun."""
    every = sorted(path.parent for path in folder.rglob(manifest))
    finished = [path for path in every if (path / table).exists()]
    return finished, [path for path in every if path not in finished]


def _name_unfinished(begun: Iterable[Path]) -> None:
    for path in begun:
        logger.warning("%s: not finished, left out", path)


def find_runs(
    folders: Iterable[Path], manifest: str, table: str, read: Callable[[Path], Found]
) -> list[Found]:
    """Return all finished runs of a task below some folders of results.

    Args:
        folders: folders of results.
        manifest, table: file names of a run of this task.
        read: reads the result from the folder of a run.

    Raises:
        ToolkitError: a folder does not exist or has no finished run, a run is damaged, or two
            runs have the same title.
    """
    every: list[Found] = []
    for folder in folders:
        finished, begun = _runs_below(folder, manifest, table)
        if not finished:
            problem = "no finished run here" + ("" if begun else ", no results of std-bench at all")
            hint = "run the same std-bench command again to go on" if begun else None
            raise ToolkitError(problem, path=folder, hint=hint)
        _name_unfinished(begun)
        every += [read(path) for path in finished]
    every = list({result.folder.resolve(): result for result in every}.values())
    places = names_of_data([r.named for r in every], [r.data for r in every])
    found: dict[str, Found] = {}
    for result, place in zip(every, places, strict=True):
        result = result.at(place)
        other = found.setdefault(result.title, result)
        if other is not result:
            raise ToolkitError(
                f"{result.title} stands in two folders",
                path=result.folder,
                value=str(other.folder),
                hint="give one of them another name with --label",
            )
        if result.missing:
            logger.warning(
                "%s: not finished: %d of %d frames are missing",
                result.folder, result.missing, result.frames,
            )  # fmt: skip
    return list(found.values())
