"""The leaderboard: one row per method, measured or published, on every split, grid and subset."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from benchmark.data.splits import get_split, splits
from benchmark.evaluation import probes
from benchmark.evaluation.results import ERROR, FAILURES, INDEX
from benchmark.evaluation.tasks.depth_results import (
    OVER_ALL,
    OVER_ANSWERED,
    RunResult,
    summarise,
    summarise_seen,
)
from benchmark.metrics.depth.figures import COVERAGE, FIGURES
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.significance import compare_methods
from benchmark.published.load import published_depth, published_speed
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Column
from std_toolkit.log import logger

MEASURED, PUBLISHED = "measured", "published"

# Metric for comparing and ranking methods.
RANKED_BY = "rmse"

SIGNIFICANT = 0.05

# Protocol whose figures are comparable with those of papers without a caution.
PAPERS_PROTOCOL = "paper"


METRICS = tuple(figure.column for figure in FIGURES)

COSTS = (
    Column(name="frames_per_s", heading="speed", unit="frames/s", lower_is_better=False),
    Column(name="parameters", heading="parameters", unit="M", factor=1e-6, digits=2),
    Column(name="gmacs", heading="MACs", unit="G"),
    Column(name="peak_memory_mib", heading="peak memory", unit="MiB", digits=0),
)

BOARD = (*METRICS, COVERAGE)

INTERVALS = tuple(f"{name}_{end}" for name in OVER_ALL for end in ("low", "high"))


@dataclass(frozen=True)
class Board:
    """Data of the tables and the page.

    Attributes:
        rows: see `COLUMNS`.
        tables: rows of all frames, as `RunResult.table`, of all runs.
        results: the runs.
    """

    rows: pd.DataFrame
    tables: pd.DataFrame
    results: tuple[RunResult, ...]

    def main_rows(self, split: str, protocol: str) -> pd.DataFrame:
        """Return the rows that methods are ranked by: main grid and subset."""
        grid, subset = get_protocol(protocol).main
        return self.part(split, protocol, grid, subset)

    def part(self, split: str, protocol: str, grid: str, subset: str) -> pd.DataFrame:
        """Return the rows of one split, protocol, grid and subset: first measured, then published
        ones, each best first."""
        rows = self.rows
        chosen = (rows["split"] == split) & (rows["protocol"] == protocol)
        chosen &= (rows["grid"] == grid) & (rows["subset"] == subset)
        by = ["kind", RANKED_BY, "method"]  # "measured" comes before "published"
        return rows[chosen].sort_values(by, kind="stable", ignore_index=True)

    def frames(self, split: str) -> int:
        """Return the largest number of scored frames of the split over runs."""
        runs = [r for r in self.results if r.manifest.setup.split == split]
        return max(r.manifest.setup.frames - r.missing for r in runs)

    @property
    def boards(self) -> list[tuple[str, str]]:
        """Return the measured pairs of split and protocol."""
        found = self.rows.loc[self.rows["kind"] == MEASURED, ["split", "protocol"]]
        return list(found.drop_duplicates().itertuples(index=False, name=None))


# split, protocol, grid, subset, method: key of the row. kind: MEASURED or PUBLISHED. Numbers of
# frames and scenes included, and of failed frames. OVER_ALL with INTERVALS, OVER_ANSWERED. p_best:
# corrected p of the comparison with the best measured method. Then cost. Then, for published rows,
# source and training data. Last what a user sees of the method, the same in all of its rows.
COLUMNS = (
    "split", "protocol", "grid", "subset", "method", "kind", "frames", "scenes", "failed",
    *OVER_ALL, *INTERVALS, *OVER_ANSWERED, "p_best", "frames_per_s", "parameters", "gmacs",
    "peak_memory_mib", "hardware", "training_data", "table", *probes.NAMES,
)  # fmt: skip


def frames_of(split: str, frames: int) -> str:
    """Format the number of scored frames, with the size of the split if they are only a part.

    >>> frames_of("std-catknown", 36), frames_of("scenes", 36)
    ('36 of 22,500 frames', '36 frames')
    """
    if is_fragment(split, frames):
        return f"{frames:,} of {_split_size(split):,} frames"
    return f"{frames:,} frame{'' if frames == 1 else 's'}"


def is_fragment(split: str, frames: int) -> bool:
    """Whether `frames` is less than the published size of the split."""
    size = _split_size(split)
    return size is not None and frames < size


def _split_size(split: str) -> int | None:
    # A name such as `module:SPLIT` comes from a result file: do not import it.
    known = get_split(split).published if split in splits.names() else ()
    return min((p.frames for p in known if not p.of_more), default=None)


def merge_equal(rows: pd.DataFrame, figures: Sequence[str]) -> pd.DataFrame:
    """Merge published rows of a method with equal figures into one row that lists all sources.

    Args:
        rows: published rows, with columns `split`, `protocol`, `subset`, `method`, `table` and
            `training_data`.
        figures: names of the columns that must be equal.
    """
    keys = ["split", "protocol", "subset", "method", *(f for f in figures if f in rows)]

    def joined(values: pd.Series) -> str:
        return "; ".join(dict.fromkeys(str(v) for v in values if isinstance(v, str) and v))

    merged = rows.groupby(keys, dropna=False, sort=False, as_index=False)
    others = [c for c in rows if c not in (*keys, "table", "training_data")]
    how = {"table": joined, "training_data": joined, **dict.fromkeys(others, "first")}
    return merged.agg(how)


def one_of_each(rows: pd.DataFrame) -> pd.DataFrame:
    """Remove repeated figures and training ablations of published methods; rows of the papers'
    method comparisons are kept."""
    printed = rows[rows["kind"] == PUBLISHED]
    printed = printed.sort_values(["table", "training_data"], kind="stable")
    further = printed.index[printed["method"].duplicated()]
    return rows.drop(index=further)


def make_board(
    results: Sequence[RunResult], *, published: bool = True, samples: int = 2000
) -> Board:
    """Combine runs in one leaderboard.

    Args:
        results: at least one run.
        published: include published figures for the same splits and subsets.
        samples: bootstrap samples of scenes for intervals and comparisons.

    Raises:
        ToolkitError: no run has a frame with pixels to compare.
    """
    tables = pd.concat([result.table for result in results], ignore_index=True)
    scored = tables[tables["grid"] != ""]
    parts = []
    for (split, protocol), one in scored.groupby(["split", "protocol"], sort=False):
        means = summarise(one, samples=samples)
        means = means[means["frames"] > 0]
        grid, subset = get_protocol(str(protocol)).main
        if not ((means["grid"] == grid) & (means["subset"] == subset)).any():
            logger.warning(
                "%s, %s: left out; no frame has a pixel to compare on %s, %s",
                split, protocol, grid, subset,
            )  # fmt: skip
            continue
        parts.append(_with_significance(means, one))
    if not parts:
        raise ToolkitError(
            "no frame could be scored, there is nothing to report",
            path=results[0].folder,
            hint=f"{FAILURES} beside the tables tells what failed",
        )
    rows = pd.concat(parts, ignore_index=True)
    rows["kind"] = MEASURED
    of_run = ["split", "protocol", "method"]
    rows = rows.merge(_costs(results), on=of_run, how="left")
    rows = rows.merge(summarise_seen(scored, by=of_run), on=of_run, how="left")
    if published:
        rows = pd.concat([rows, _published(rows)], ignore_index=True)
    return Board(rows.reindex(columns=list(COLUMNS)), tables, tuple(results))


def _with_significance(means: pd.DataFrame, one: pd.DataFrame) -> pd.DataFrame:
    """Add `p_best`: each method against the best of its grid and subset, corrected over pairs."""
    means = means.assign(p_best=np.nan)
    for (grid, subset), block in means.groupby(["grid", "subset"], sort=False):
        best = block.loc[block[RANKED_BY].idxmin(), "method"]
        frames = one[(one["grid"] == grid) & (one["subset"] == subset)]
        pairs = compare_methods(frames, RANKED_BY, samples=0)
        p = pd.concat(
            [
                pairs[pairs[of] == best].set_index(other)["p_flip_holm"]
                for of, other in (("first", "second"), ("second", "first"))
            ]
        )
        means.loc[block.index, "p_best"] = block["method"].map(p)
    return means


def _costs(results: Sequence[RunResult]) -> pd.DataFrame:
    rows = []
    for result in results:
        setup, speed, table = result.manifest.setup, result.speed, result.table
        row = {
            "split": setup.split,
            "protocol": setup.protocol,
            "method": result.manifest.label,
            "failed": int(table.loc[table[ERROR] != "", INDEX].nunique()),
        }
        if speed is not None:
            names = ("frames_per_s", "parameters", "gmacs", "peak_memory_mib", "hardware")
            row |= {name: getattr(speed, name) for name in names}
        rows.append(row)
    columns = ["split", "protocol", "method", "failed", "frames_per_s", "parameters", "gmacs"]
    return pd.DataFrame(rows).reindex(columns=[*columns, "peak_memory_mib", "hardware"])


def _published(rows: pd.DataFrame) -> pd.DataFrame:
    """Published rows for the measured splits and subsets, on the main grids of the protocols."""
    printed = published_depth()
    speeds = published_speed()
    parts = []
    for split, protocol in rows[["split", "protocol"]].drop_duplicates().itertuples(index=False):
        grid, _ = get_protocol(protocol).main
        chosen = (rows["split"] == split) & (rows["protocol"] == protocol) & (rows["grid"] == grid)
        subsets = set(rows.loc[chosen, "subset"])
        part = printed[(printed["split"] == split) & printed["subset"].isin(subsets)]
        parts.append(part.assign(protocol=protocol, grid=grid))
    found = merge_equal(pd.concat(parts, ignore_index=True), OVER_ALL).assign(kind=PUBLISHED)
    return found.assign(frames_per_s=found["method"].map(speeds), hardware="NVIDIA RTX 3090")
