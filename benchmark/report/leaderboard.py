"""The leaderboard: one row per method, measured or published, on every split, grid and subset.

How figures are written: headings, units, digits, and which way is better.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from benchmark.evaluation.results import ERROR, FAILURES, INDEX
from benchmark.evaluation.tasks.depth_results import OVER_ALL, OVER_ANSWERED, RunResult, summarise
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.significance import compare_methods
from benchmark.published.load import published_depth, published_speed
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

MEASURED, PUBLISHED = "measured", "published"

# Methods are compared, and ranked, by it.
RANKED_BY = "rmse"

SIGNIFICANT = 0.05

# A protocol whose figures a paper's may be read beside without a caution.
PAPERS_PROTOCOL = "paper"


@dataclass(frozen=True)
class Column:
    """A figure of the leaderboard.

    Attributes:
        name: its column.
        heading, unit: as people read it.
        factor: from the stored to the written unit.
        digits: after the point.
        less_is_better: None where neither way is.
        printed_digits: of figures that a paper prints, which has fewer.
    """

    name: str
    heading: str
    unit: str = ""
    factor: float = 1.0
    digits: int = 2
    less_is_better: bool | None = True
    printed_digits: int = 2

    def text(self, value: float | None, *, printed: bool = False) -> str:
        """The figure as it is written; empty where there is none."""
        if value is None or math.isnan(value):
            return ""
        return f"{value * self.factor:.{self.printed_digits if printed else self.digits}f}"

    @property
    def title(self) -> str:
        """Heading and unit."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading


METRICS = (
    Column("rmse", "RMSE", "mm", 1e3, 1, printed_digits=0),
    Column("rel", "REL", "", 1.0, 4, printed_digits=3),
    Column("mae", "MAE", "mm", 1e3, 1, printed_digits=0),
    Column("d105", "δ1.05", "%", 1e2, 2, less_is_better=False),
    Column("d110", "δ1.10", "%", 1e2, 2, less_is_better=False),
    Column("d125", "δ1.25", "%", 1e2, 2, less_is_better=False),
)

COVERAGE = Column("coverage", "answered", "%", 1e2, 2, less_is_better=False)

SPEED = Column("frames_per_s", "speed", "frames/s", 1.0, 1, less_is_better=False)

PARAMETERS = Column("parameters", "parameters", "M", 1e-6, 2, less_is_better=None)

MACS = Column("gmacs", "MACs", "G", 1.0, 1, less_is_better=None)

MEMORY = Column("peak_memory_mib", "peak memory", "MiB", 1.0, 0, less_is_better=None)

COSTS = (SPEED, PARAMETERS, MACS, MEMORY)

BOARD = (*METRICS, COVERAGE)

INTERVALS = tuple(f"{name}_{end}" for name in OVER_ALL for end in ("low", "high"))


@dataclass(frozen=True)
class Board:
    """All that the formats and the page show.

    Attributes:
        rows: see `COLUMNS`.
        tables: rows of all frames, as `RunResult.table`, of all runs.
        results: the runs.
    """

    rows: pd.DataFrame
    tables: pd.DataFrame
    results: tuple[RunResult, ...]

    def main_rows(self, split: str, protocol: str) -> pd.DataFrame:
        """The rows that methods are ranked by: main grid and subset, best first."""
        grid, subset = get_protocol(protocol).main
        return self.part(split, protocol, grid, subset)

    def part(self, split: str, protocol: str, grid: str, subset: str) -> pd.DataFrame:
        """The rows of one split, protocol, grid and subset, best first."""
        rows = self.rows
        chosen = (rows["split"] == split) & (rows["protocol"] == protocol)
        chosen &= (rows["grid"] == grid) & (rows["subset"] == subset)
        return rows[chosen].sort_values([RANKED_BY, "method"], kind="stable", ignore_index=True)

    @property
    def boards(self) -> list[tuple[str, str]]:
        """Splits and protocols that were measured."""
        found = self.rows.loc[self.rows["kind"] == MEASURED, ["split", "protocol"]]
        return list(found.drop_duplicates().itertuples(index=False, name=None))


# split, protocol, grid, subset, method: which row it is. kind: MEASURED or PUBLISHED. frames and
# scenes that entered, frames that failed. OVER_ALL with INTERVALS, OVER_ANSWERED. p_best: corrected
# probability that the best measured method is not better. Then what it costs. Then, of published
# rows, where they are printed and what was trained on.
COLUMNS = (
    "split", "protocol", "grid", "subset", "method", "kind", "frames", "scenes", "failed",
    *OVER_ALL, *INTERVALS, *OVER_ANSWERED, "p_best", "frames_per_s", "parameters", "gmacs",
    "peak_memory_mib", "hardware", "training_data", "table",
)  # fmt: skip


def one_of_each(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows without the further ones that papers print of a method: repetitions of a figure in
    other tables, and ablations of its training. What its comparison of methods prints stays."""
    printed = rows[rows["kind"] == PUBLISHED]
    printed = printed.sort_values(["table", "training_data"], kind="stable")
    further = printed.index[printed["method"].duplicated()]
    return rows.drop(index=further)


def make_board(
    results: Sequence[RunResult], *, published: bool = True, samples: int = 2000
) -> Board:
    """Join runs to one leaderboard.

    Args:
        results: at least one.
        published: with the figures that papers print for the same splits and subsets.
        samples: draws of scenes for intervals and comparisons.

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
        parts.append(_with_significance(means, one, samples))
    if not parts:
        raise ToolkitError(
            "no frame could be scored, there is nothing to report",
            path=results[0].folder,
            hint=f"{FAILURES} beside the tables tells what failed",
        )
    rows = pd.concat(parts, ignore_index=True)
    rows["kind"] = MEASURED
    rows = rows.merge(_costs(results), on=["split", "protocol", "method"], how="left")
    if published:
        rows = pd.concat([rows, _published(rows)], ignore_index=True)
    return Board(rows.reindex(columns=list(COLUMNS)), tables, tuple(results))


def _with_significance(means: pd.DataFrame, one: pd.DataFrame, samples: int) -> pd.DataFrame:
    """`p_best`: of each method against the best of its grid and subset, all pairs corrected."""
    means = means.assign(p_best=np.nan)
    for (grid, subset), block in means.groupby(["grid", "subset"], sort=False):
        best = block.loc[block[RANKED_BY].idxmin(), "method"]
        frames = one[(one["grid"] == grid) & (one["subset"] == subset)]
        pairs = compare_methods(frames, RANKED_BY, samples=samples)
        for pair in pairs.itertuples():
            if best in (pair.first, pair.second):
                other = pair.second if pair.first == best else pair.first
                at = block.index[block["method"] == other]
                means.loc[at, "p_best"] = pair.p_flip_holm
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
    """Published rows of the splits and subsets that were measured, on the protocols' main grids."""
    printed = published_depth()
    speeds = published_speed()
    parts = []
    for split, protocol in rows[["split", "protocol"]].drop_duplicates().itertuples(index=False):
        grid, _ = get_protocol(protocol).main
        chosen = (rows["split"] == split) & (rows["protocol"] == protocol) & (rows["grid"] == grid)
        subsets = set(rows.loc[chosen, "subset"])
        part = printed[(printed["split"] == split) & printed["subset"].isin(subsets)]
        parts.append(part.assign(protocol=protocol, grid=grid))
    found = pd.concat(parts, ignore_index=True).assign(kind=PUBLISHED)
    return found.assign(frames_per_s=found["method"].map(speeds), hardware="NVIDIA RTX 3090")
