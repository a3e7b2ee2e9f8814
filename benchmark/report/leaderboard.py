"""The leaderboard: one row per method, measured or published, on every split, grid and subset."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from benchmark.evaluation import probes
from benchmark.evaluation.known_data import published_size
from benchmark.evaluation.results import FAILURES, counted, unanswered
from benchmark.evaluation.tasks.depth_results import (
    OVER_ALL,
    OVER_ANSWERED,
    RunResult,
    summarise,
    summarise_seen,
)
from benchmark.metrics.depth.figures import FIGURES, shown_columns
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

METRICS = tuple(figure.column for figure in FIGURES)

BOARD = shown_columns()

COSTS = (
    Column(name="frames_per_s", heading="speed", unit="frames/s", lower_is_better=False),
    Column(name="processor_s", heading="processor", unit="s/frame", digits=3),
    Column(name="load", heading="load", digits=1),
    Column(name="parameters", heading="parameters", unit="M", factor=1e-6, digits=2),
    Column(name="gmacs", heading="MACs", unit="G"),
    Column(name="peak_memory_mib", heading="peak memory", unit="MiB", digits=0),
)

_COSTS = (*(column.name for column in COSTS), "hardware")

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
        """Return the rows of one split, protocol, grid and subset, each kind best first: measured
        ones, those that lack frames, published ones."""
        rows = self.rows
        chosen = (rows["split"] == split) & (rows["protocol"] == protocol)
        chosen &= (rows["grid"] == grid) & (rows["subset"] == subset)
        found = rows[chosen].assign(lacks=~is_ranked(rows[chosen]))
        by = ["kind", "lacks", RANKED_BY, "method"]  # "measured" comes before "published"
        return found.sort_values(by, kind="stable", ignore_index=True).drop(columns="lacks")

    def counted(self, split: str) -> str:
        """Return the largest number of scored frames over runs, and where they come from."""
        return counted(self.runs(split))

    def runs(self, split: str) -> list[RunResult]:
        """Return the runs on a data set."""
        return [r for r in self.results if r.place == split]

    @property
    def boards(self) -> list[tuple[str, str]]:
        """Return the measured pairs of split and protocol."""
        found = self.rows.loc[self.rows["kind"] == MEASURED, ["split", "protocol"]]
        return list(found.drop_duplicates().itertuples(index=False, name=None))


# split, protocol, grid, subset, method: key of the row. Of a measured method: preset, digest of the
# weights, class of speed, and place among the ranked ones of its class. kind: MEASURED or
# PUBLISHED. Where the frames come from. Numbers of frames and scenes included, of frames at which
# the method failed, and of those of the data set without an answer: rows with any are not ranked.
# OVER_ALL with INTERVALS, OVER_ANSWERED. p_best: corrected p of the comparison with the best ranked
# method of its class. Then cost, what the method was trained on, and of published
# rows table, source (key of published_sources.csv) and grade.
# Last what a user sees of the method, the same in all of its rows.
COLUMNS = (
    "split", "protocol", "grid", "subset", "method", "preset", "weights", "speed_class", "place",
    "kind", "provenance", "frames", "scenes",
    "failed", "unanswered",
    *OVER_ALL, *INTERVALS, *OVER_ANSWERED, "p_best", "frames_per_s", "processor_s",
    "load", "parameters", "gmacs", "peak_memory_mib", "hardware", "training_data", "table",
    "source", "trust",
    *probes.NAMES,
)  # fmt: skip


def frames_of(split: str, frames: int) -> str:
    """Format the number of scored frames, with the size of the split if they are only a part.

    >>> frames_of("std-catknown", 36), frames_of("scenes", 36)
    ('36 of 22,500 frames', '36 frames')
    """
    size = published_size(split)
    if frames < size:
        return f"{frames:,} of {size:,} frames"
    return f"{frames:,} frame{'' if frames == 1 else 's'}"


def is_ranked(rows: pd.DataFrame) -> pd.Series:
    """Whether each row competes: measured, with an answer to every frame of its data set."""
    return (rows["kind"] == MEASURED) & (rows["unanswered"].fillna(0) == 0)


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
    told = ("table", "training_data", "source", "trust")
    how = {c: joined if c in told else "first" for c in rows if c not in keys}
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
        here = {
            r.manifest.label: r
            for r in results
            if (r.place, r.manifest.setup.protocol) == (split, protocol)
        }
        missing = unanswered(here.values())
        means["unanswered"] = [missing[here[label].title] for label in means["method"]]
        means["speed_class"] = [here[label].speed_class for label in means["method"]]
        parts.append(_with_significance(means, one))
    if not parts:
        raise ToolkitError(
            "no frame could be scored, there is nothing to report",
            path=results[0].folder,
            hint=f"{FAILURES} beside the tables tells what failed",
        )
    rows = pd.concat(parts, ignore_index=True).assign(kind=MEASURED)
    of_run = ["split", "protocol", "method"]
    rows = rows.merge(_costs(results), on=of_run, how="left")
    rows = rows.merge(summarise_seen(scored, by=of_run), on=of_run, how="left")
    if published:
        rows = pd.concat([rows, _published(rows, results)], ignore_index=True)
    return Board(rows.reindex(columns=list(COLUMNS)), tables, tuple(results))


def _with_significance(means: pd.DataFrame, one: pd.DataFrame) -> pd.DataFrame:
    """Add `p_best`: each method against the best of its grid, subset and class of speed, corrected
    over pairs; and its `place` there."""
    means = means.assign(p_best=np.nan, place=np.nan)
    whole = means[means["unanswered"] == 0]
    for (grid, subset, _), block in whole.groupby(["grid", "subset", "speed_class"], sort=False):
        means.loc[block.index, "place"] = block[RANKED_BY].rank(method="min")
        best = block.loc[block[RANKED_BY].idxmin(), "method"]
        frames = one[(one["grid"] == grid) & (one["subset"] == subset)]
        frames = frames[frames["method"].isin(block["method"])]
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
        speed = result.speed
        row: dict[str, object] = {
            "split": result.place,
            "protocol": result.manifest.setup.protocol,
            "method": result.manifest.label,
            "provenance": str(result.data.provenance),
            "preset": result.preset,
            "weights": result.manifest.setup.weights_sha256,
            "training_data": result.training_data,
        }
        said = result.said
        if speed is not None:
            row |= {name: getattr(speed, name) for name in _COSTS}
        elif said is not None:
            seconds = said.seconds_per_frame
            row |= {"frames_per_s": 1 / seconds if seconds else np.nan, "hardware": said.hardware}
        rows.append(row)
    told = ["provenance", "preset", "weights", "training_data"]
    return pd.DataFrame(rows).reindex(columns=["split", "protocol", "method", *told, *_COSTS])


def _published(rows: pd.DataFrame, results: Sequence[RunResult]) -> pd.DataFrame:
    """Published rows for the measured subsets, on the main grids of their own protocols: only of
    data sets whose frames are the published ones."""
    printed = published_depth()
    speeds = published_speed()
    parts = []
    names = {r.place: r.manifest.setup.split for r in results if r.data.is_published}
    for place, protocol in rows[["split", "protocol"]].drop_duplicates().itertuples(index=False):
        if place not in names:
            continue
        grid, _ = get_protocol(protocol).main
        chosen = (rows["split"] == place) & (rows["protocol"] == protocol) & (rows["grid"] == grid)
        subsets = set(rows.loc[chosen, "subset"])
        part = printed[(printed["split"] == names[place]) & (printed["protocol"] == protocol)]
        parts.append(part[part["subset"].isin(subsets)].assign(split=place, grid=grid))
    if not parts:
        return pd.DataFrame()
    found = merge_equal(pd.concat(parts, ignore_index=True), OVER_ALL).assign(kind=PUBLISHED)
    return found.assign(frames_per_s=found["method"].map(speeds), hardware="NVIDIA RTX 3090")
