"""The leaderboard of poses: a row for each method, depth and fit, measured or published."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from benchmark.metrics.pose import PoseProtocol, get_pose_protocol
from benchmark.pose_running.comparing import PoseDifference, compare_runs
from benchmark.pose_running.depths import RAW, TRUE
from benchmark.pose_running.plan import FITS
from benchmark.pose_running.results import PoseResult
from benchmark.pose_running.scoring import ALL, HARD, SAMPLES, SUBSETS, Scored, score_run
from benchmark.pose_running.show import heading
from benchmark.published.poses import published_poses
from benchmark.report.board import MEASURED, PUBLISHED
from benchmark.report.columns import Column
from std_toolkit.errors import ToolkitError

# The protocols of the tables; comparisons are by the first.
PROTOCOLS = ("strict", "paper")
TABLES = (ALL, HARD)
DETAILS = tuple(name for name in SUBSETS if name not in TABLES)
# What "right" means in comparisons, breakdowns and the answer.
MAIN = "5deg5cm"
FIGURES = tuple(
    Column(name, heading(name), "%", 1e2, 1, less_is_better=False, printed_digits=1)
    for name in get_pose_protocol(PROTOCOLS[0]).columns
)
INTERVALS = tuple(f"{c.name}_{end}" for c in FIGURES for end in ("low", "high"))
COLUMNS = (
    "split", "protocol", "subset", "method", "depth", "fit", "kind", "objects", "frames", "scenes",
    "failed", *(c.name for c in FIGURES), *INTERVALS, "training_data", "table",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Compared:
    """A run against the same method on raw depth.

    Attributes:
        scored: the run.
        difference: the run minus that on raw depth; None where they cannot be compared.
        why_not: in that case why.
    """

    scored: Scored
    difference: PoseDifference | None
    why_not: str = ""


@dataclass(frozen=True, eq=False)
class PoseBoard:
    """All that the formats and the page show.

    Attributes:
        rows: see `COLUMNS`; shares.
        details: by split, the runs by the first protocol, for all objects and for those of each
            single material, without intervals.
        compared: by split and subset of `TABLES`, the runs on other than raw depth.
        results: the runs.
    """

    rows: pd.DataFrame
    details: dict[str, list[Scored]]
    compared: dict[tuple[str, str], list[Compared]]
    results: tuple[PoseResult, ...]

    @property
    def splits(self) -> list[str]:
        """That were measured."""
        return list(dict.fromkeys(result.split for result in self.results))

    def part(self, split: str, protocol: str, subset: str) -> pd.DataFrame:
        """The rows of one table."""
        rows = self.rows
        chosen = (rows["split"] == split) & (rows["protocol"] == protocol)
        return rows[chosen & (rows["subset"] == subset)].reset_index(drop=True)


def make_pose_board(
    results: Sequence[PoseResult], *, published: bool = True, samples: int = SAMPLES
) -> PoseBoard:
    """Score runs and compare them.

    Args:
        results: at least one.
        published: with the figures that papers print for the same splits and subsets.
        samples: draws of scenes for intervals.

    Raises:
        ToolkitError: no run has a frame with a true object.
    """
    ordered = sorted(results, key=lambda r: (r.split, r.name[0], FITS.index(r.name[2]), _place(r)))
    rows, details, compared = [], {}, {}
    for split in dict.fromkeys(result.split for result in ordered):
        mine = [result for result in ordered if result.split == split]
        for name in PROTOCOLS:
            protocol = get_pose_protocol(name)
            for subset in TABLES:
                scored = _scored(mine, protocol, subset, samples)
                rows += [_row(each, name) for each in scored]
                if name == PROTOCOLS[0]:
                    compared[split, subset] = _against_raw(scored, samples)
        first = get_pose_protocol(PROTOCOLS[0])
        details[split] = [s for subset in (ALL, *DETAILS) for s in _scored(mine, first, subset, 0)]
    if not rows:
        raise ToolkitError(
            "no frame has a true object, there is nothing to report", path=results[0].folder
        )
    board = pd.DataFrame(rows)
    if published:
        board = pd.concat([board, _published(board)], ignore_index=True)
    return PoseBoard(board.reindex(columns=list(COLUMNS)), details, compared, tuple(ordered))


def _place(result: PoseResult) -> tuple[int, str]:
    """Raw depth before restored depth, true depth last."""
    depth = result.manifest.setup.depth
    return (0 if depth == RAW else 2 if depth == TRUE else 1, result.name[1])


def _scored(
    results: Sequence[PoseResult], protocol: PoseProtocol, subset: str, samples: int
) -> list[Scored]:
    scored = [score_run(result, protocol, subset, samples=samples) for result in results]
    return [each for each in scored if each.objects]


def _row(scored: Scored, protocol: str) -> dict[str, object]:
    method, depth, fit = scored.result.name
    row: dict[str, object] = {
        "split": scored.result.split,
        "protocol": protocol,
        "subset": scored.subset,
        "method": method,
        "depth": depth,
        "fit": fit,
        "kind": MEASURED,
        "objects": scored.objects,
        "frames": len(scored.scenes),
        "scenes": scored.scene_count,
        "failed": scored.result.failed,
    }
    for column, value in scored.scores.mean.items():
        row[column] = value
        row[f"{column}_low"], row[f"{column}_high"] = scored.interval(column)
    return row


def _against_raw(scored: Sequence[Scored], samples: int) -> list[Compared]:
    """Runs on other depths, each with the run of the same method and fit on raw depth."""
    raw = {(s.result.name[0], s.result.name[2]): s for s in scored if s.result.name[1] == RAW}
    found = []
    for each in scored:
        method, depth, fit = each.result.name
        if depth == RAW:
            continue
        base = raw.get((method, fit))
        if base is None:
            found.append(Compared(each, None, "not run on raw depth"))
            continue
        try:
            found.append(Compared(each, compare_runs(each, base, samples=samples)))
        except ToolkitError as error:
            found.append(Compared(each, None, error.problem))
    return found


def _published(board: pd.DataFrame) -> pd.DataFrame:
    """Published rows of the splits and subsets that were measured, beside every protocol."""
    printed = published_poses()
    parts = []
    for split, protocol, subset in (
        board[["split", "protocol", "subset"]].drop_duplicates().itertuples(index=False)
    ):
        part = printed[(printed["split"] == split) & (printed["subset"] == subset)]
        parts.append(part.assign(protocol=protocol))
    return pd.concat(parts, ignore_index=True).assign(kind=PUBLISHED, depth="", fit="")
