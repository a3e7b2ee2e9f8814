"""The leaderboard of poses: a row for each method, depth and fit, measured or published.

It also tests whether one depth gives better poses than another, on the same frames with the same
method. Scenes are independent. Average precision is not a mean over frames, so that there are no
differences per scene. But if the depth had no effect, the predictions of each scene could be
swapped between the two depths, and the figures of all swapped tables would be equally likely.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmark.evaluation.config import AS_FILED, FITS
from benchmark.evaluation.depth_choice import RAW, TRUE
from benchmark.evaluation.results import counted, unanswered
from benchmark.evaluation.tasks import pose_results
from benchmark.metrics.pose import get_pose_protocol
from benchmark.metrics.pose.resampling import resampled_scores, scene_weights, side_by_side
from benchmark.published.load import published_poses
from benchmark.report.leaderboard import MEASURED, PUBLISHED, is_ranked, merge_equal
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Column

Floats = NDArray[np.float64]

EXACT_SCENES = 11  # up to this number, all 2**scenes swaps are enumerated

FLIPS = 2000  # random swaps for more scenes

# The protocols of the tables; comparisons are by the first.
PROTOCOLS = ("strict", "paper")

TABLES = (pose_results.ALL, pose_results.HARD)

# Criterion of a correct pose in comparisons, breakdowns and the answer.
MAIN = "5deg5cm"


@dataclass(frozen=True, eq=False)
class PoseDifference:
    """Difference of two runs on the same frames, by one protocol.

    Attributes:
        columns: names of the K figures.
        difference: (K,) first minus second, as fractions.
        low, high: (K,) 95 % interval over scenes; NaN with one scene.
        p: (K,) two-sided p of the swap test: the fraction of random swaps of scenes between the
            two runs with a difference at least as large. It is at least 2 / 2**scenes: with five
            scenes or fewer no difference is significant at 0.05.
        scenes, frames: numbers of scenes and frames compared.
    """

    columns: tuple[str, ...]
    difference: Floats
    low: Floats
    high: Floats
    p: Floats
    scenes: int
    frames: int

    def of(self, column: str) -> tuple[float, float, float, float]:
        """Return difference, ends of its interval, and p of a column."""
        i = self.columns.index(column)
        values = (self.difference[i], self.low[i], self.high[i], self.p[i])
        return values[0].item(), values[1].item(), values[2].item(), values[3].item()


def compare_runs(
    first: pose_results.Scored,
    second: pose_results.Scored,
    *,
    samples: int = pose_results.SAMPLES,
    seed: int = 0,
) -> PoseDifference:
    """Compare two runs.

    Args:
        first, second: runs scored by the same protocol on the same objects.
        samples: bootstrap samples for the interval.
        seed: seed of interval and test.

    Raises:
        ToolkitError: the runs do not have the same frames and objects.
    """
    same = (
        np.array_equal(first.names, second.names)
        and np.array_equal(first.scenes, second.scenes)
        and first.objects == second.objects
    )
    if not same:
        raise ToolkitError(
            "only runs over the same frames can be compared",
            value=", ".join(second.result.name),
            hint="run both over all frames, with the same --limit",
        )
    both = side_by_side(first.matches, second.matches)
    scenes = len(np.unique(first.scenes))
    frames = len(first.scenes)

    def differences(of_first: Floats, of_second: Floats) -> Floats:
        """(D, K) differences for scene weights (D, scenes) of the first and the second run."""
        a, b = (scene_weights(first.scenes, w) for w in (of_first, of_second))
        return resampled_scores(both, np.hstack([a, b])) - resampled_scores(both, np.hstack([b, a]))

    ones, zeros = np.ones((1, scenes)), np.zeros((1, scenes))
    observed = differences(ones, zeros)[0]
    low = high = np.full(len(observed), np.nan)
    if scenes > 1:
        draws = pose_results.scene_draws(scenes, samples, seed=seed)
        drawn = differences(draws, np.zeros_like(draws))
        low, high = pose_results.interval_of(drawn)
    swaps = _swaps(scenes, seed)
    swapped = differences(1.0 - swaps, swaps)
    # The same figures summed in another order differ in their last bits.
    reached = (np.abs(swapped) >= np.abs(observed) - 1e-12).sum(axis=0)
    exact = scenes <= EXACT_SCENES
    p = reached / len(swaps) if exact else (reached + 1) / (len(swaps) + 1)
    p = np.where(np.isnan(observed), np.nan, p)
    columns = first.scores.columns
    return PoseDifference(columns, observed, low, high, p, scenes, frames)


def _swaps(scenes: int, seed: int) -> Floats:
    """(W, scenes) swapped scenes: all combinations, or a random sample of them."""
    if scenes <= EXACT_SCENES:
        ways: Floats = (np.arange(2**scenes)[:, None] >> np.arange(scenes) & 1).astype(np.float64)
        return ways
    rng = np.random.default_rng(seed)
    return rng.integers(0, 2, (FLIPS, scenes)).astype(np.float64)


DETAILS = tuple(name for name in pose_results.SUBSETS if name not in TABLES)

FIGURES = tuple(
    Column(
        name=name, heading=pose_results.heading(name), unit="%", factor=100, lower_is_better=False
    )
    for name in get_pose_protocol(PROTOCOLS[0]).columns
)

INTERVALS = tuple(f"{c.name}_{end}" for c in FIGURES for end in ("low", "high"))

COLUMNS = (
    "split", "protocol", "subset", "method", "depth", "fit", "kind", "provenance", "objects",
    "frames", "scenes", "failed", "unanswered", *(c.name for c in FIGURES), *INTERVALS,
    "training_data", "table", "source", "trust",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Compared:
    """A run against the same method on raw depth.

    Attributes:
        scored: the run.
        difference: the run minus that on raw depth; None if they cannot be compared.
        why_not: the reason if they cannot be compared.
    """

    scored: pose_results.Scored
    difference: PoseDifference | None
    why_not: str = ""


@dataclass(frozen=True, eq=False)
class PoseBoard:
    """Data of the tables and the page.

    Attributes:
        rows: see `COLUMNS`; as fractions.
        details: by split, the runs by the first protocol, for all objects and for each single
            material, without intervals.
        compared: by split and subset of `TABLES`, the runs on depth other than raw.
        results: the runs.
    """

    rows: pd.DataFrame
    details: dict[str, list[pose_results.Scored]]
    compared: dict[tuple[str, str], list[Compared]]
    results: tuple[pose_results.PoseResult, ...]

    @property
    def splits(self) -> list[str]:
        """Return the measured splits."""
        return list(dict.fromkeys(result.split for result in self.results))

    def counted(self, split: str) -> str:
        """Return the largest number of scored frames over runs, and where they come from."""
        return counted(r for r in self.results if r.split == split)

    def contests(self, rows: pd.DataFrame) -> list[bool]:
        """Return whether each row of `part` competes: it is measured, with an answer to every
        frame, without true depth, and by a method that receives no ground truth."""
        bounds = {(r.split, *r.name) for r in self.results if r.given_truth or r.name[1] == TRUE}
        names = rows[["split", "method", "depth", "fit"]].itertuples(index=False, name=None)
        measured = is_ranked(rows)
        return [bool(m) and n not in bounds for m, n in zip(measured, names, strict=True)]

    def part(self, split: str, protocol: str, subset: str) -> pd.DataFrame:
        """Return the rows of one table."""
        rows = self.rows
        chosen = (rows["split"] == split) & (rows["protocol"] == protocol)
        return rows[chosen & (rows["subset"] == subset)].reset_index(drop=True)


def make_pose_board(
    results: Sequence[pose_results.PoseResult],
    *,
    published: bool = True,
    samples: int = pose_results.SAMPLES,
) -> PoseBoard:
    """Score runs and compare them.

    Args:
        results: at least one run.
        published: include published figures for the same splits and subsets.
        samples: bootstrap samples of scenes for intervals.

    Raises:
        ToolkitError: no run has a frame with a true object.
    """
    fits = (*FITS, AS_FILED)
    ordered = sorted(results, key=lambda r: (r.split, r.name[0], fits.index(r.name[2]), _place(r)))
    rows, details, compared = [], {}, {}
    for split in dict.fromkeys(result.split for result in ordered):
        mine = [result for result in ordered if result.split == split]
        missing = unanswered(mine)
        for name in PROTOCOLS:
            protocol = get_pose_protocol(name)
            for subset in TABLES:
                scored = pose_results.score_runs(mine, protocol, (subset,), samples=samples)
                rows += [_row(each, name, missing[each.result.title]) for each in scored]
                if name == PROTOCOLS[0]:
                    compared[split, subset] = _against_raw(scored, samples)
        first = get_pose_protocol(PROTOCOLS[0])
        details[split] = pose_results.score_runs(mine, first, (pose_results.ALL, *DETAILS))
    if not rows:
        raise ToolkitError(
            "no frame has a true object, there is nothing to report", path=results[0].folder
        )
    board = pd.DataFrame(rows)
    if published:
        board = pd.concat([board, _published(board, ordered)], ignore_index=True)
    return PoseBoard(board.reindex(columns=list(COLUMNS)), details, compared, tuple(ordered))


def _place(result: pose_results.PoseResult) -> tuple[int, str]:
    """Sort key: raw depth before restored depth, true depth last."""
    depth = result.manifest.setup.depth
    return (0 if depth == RAW else 2 if depth == TRUE else 1, result.name[1])


def _row(scored: pose_results.Scored, protocol: str, missing: int) -> dict[str, object]:
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
        "unanswered": missing,
        "provenance": str(scored.result.data.provenance),
    }
    for column, value in scored.figures.items():
        row[column] = value
        ends = (np.nan, np.nan) if np.isnan(value) else scored.interval(column)
        row[f"{column}_low"], row[f"{column}_high"] = ends
    return row


def _against_raw(scored: Sequence[pose_results.Scored], samples: int) -> list[Compared]:
    """Compare runs on other depths with the run of the same method and fit on raw depth."""
    raw = {(s.result.name[0], s.result.name[2]): s for s in scored if s.result.name[1] == RAW}
    found = []
    for each in scored:
        method, depth, fit = each.result.name
        if depth in (RAW, AS_FILED):
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


def _published(board: pd.DataFrame, results: Sequence[pose_results.PoseResult]) -> pd.DataFrame:
    """Published rows for the measured subsets, by their own protocol: only of data sets whose
    frames are the published ones."""
    printed = published_poses()
    parts = []
    names = {r.split: r.manifest.setup.split for r in results if r.data.is_published}
    for place, protocol, subset in (
        board[["split", "protocol", "subset"]].drop_duplicates().itertuples(index=False)
    ):
        if place in names:
            part = printed[(printed["split"] == names[place]) & (printed["subset"] == subset)]
            parts.append(part[part["protocol"] == protocol].assign(split=place))
    if not parts:
        return pd.DataFrame()
    rows = merge_equal(pd.concat(parts, ignore_index=True), [c.name for c in FIGURES])
    return rows.assign(kind=PUBLISHED, depth="", fit="")
