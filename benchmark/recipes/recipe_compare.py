"""Compares the variants of a recipe in pairs, and holds each difference against the paper's.

Every pair is compared on the frames that both were scored on. The interval of the difference and
the p-value are over scenes, because frames of one scene show the same objects.
"""

from collections.abc import Hashable, Mapping, Sequence
from math import isnan, nan
from typing import Any

import pandas as pd

from benchmark.evaluation.tasks.depth_results import RunResult
from benchmark.evaluation.tasks.pose_results import ALL, HARD, PoseResult, heading, score_run
from benchmark.metrics.pose import get_pose_protocol
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.significance import compare_methods, holm
from benchmark.recipes.recipe import Printed
from benchmark.recipes.recipe_plan import Entry, RecipePlan
from benchmark.recipes.recipe_run import Outcome
from benchmark.recipes.recipe_table import RANKED_BY, SUBSET_OF, printed_rows, published_poses
from benchmark.recipes.targets import Target
from benchmark.report.leaderboard import SIGNIFICANT
from benchmark.report.parts.depth_tables import MAIN_SUBSETS, OBJECTS
from benchmark.report.parts.pose_board import compare_runs
from std_toolkit.html.table import Cell, Column, Row, Table, number

# difference: first minus second, of `figure` in metres or as a fraction; low and high: 95 %
# interval; p: two-sided, corrected for the pairs of one test, protocol and figure (Holm).
# published: the same difference of the printed figures, on data set `published_on`: the test's own,
# or the first of the table where the paper prints none for it. NaN where one of them is not
# printed or the protocol is another. reading: see `read`.
COLUMNS = (
    "recipe", "scale", "test", "subset", "protocol", "figure", "first", "second", "difference",
    "low", "high", "p", "frames", "scenes", "published", "published_on", "reading",
)  # fmt: skip
AS_PUBLISHED, OPPOSITE, UNDECIDED = "as published", "opposite to the paper", "undecided"
POSE_FIGURES = ("iou50", "5deg5cm", "10deg5cm")
_POSES_OF = {"all": "all objects", "specular_transparent": "specular and transparent objects"}
_PAPERS = "paper"
_SAMPLES = 1000


def read(low: float, high: float, p: float, published: float) -> str:
    """What a difference says about a published difference.

    Args:
        low, high: ends of its interval; NaN with one scene.
        p: its p-value. With five scenes or fewer none is below 0.05, and an interval over so few
            is too narrow.
        published: the paper's difference; NaN for none.

    Returns:
        `AS_PUBLISHED` or `OPPOSITE` if the interval lies on one side of zero and p is at most 0.05,
        else `UNDECIDED`; empty where the paper prints no difference.

    >>> read(-2.0, -1.0, 0.01, -5.0), read(-2.0, -1.0, 0.01, 5.0), read(-2.0, 1.0, 0.4, 5.0)
    ('as published', 'opposite to the paper', 'undecided')
    """
    if isnan(published) or published == 0:
        return ""
    if not p <= SIGNIFICANT or not (low > 0 or high < 0):
        return UNDECIDED
    return AS_PUBLISHED if (low > 0) == (published > 0) else OPPOSITE


def comparisons(plan: RecipePlan, outcome: Outcome) -> pd.DataFrame:
    """Differences of the recipe's pairs on every test that both were scored on; see `COLUMNS`.

    Raises:
        ToolkitError: the recipe names a table that was not published.
    """
    rows: list[dict[str, object]] = []
    for target in plan.targets:
        rows += [*_depth_rows(plan, outcome, target), *_pose_rows(plan, outcome, target)]
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    together = ["test", "protocol", "figure"]
    if len(table):
        table["p"] = table.groupby(together)["p"].transform(lambda p: holm(p.to_numpy()))
        ends = ("low", "high", "p", "published")
        table["reading"] = [read(**row) for row in table[list(ends)].to_dict("records")]
    table["recipe"], table["scale"] = plan.name, plan.scale_name
    return table


def pairs_of(plan: RecipePlan, names: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of these names that the recipe compares; by default the last with each other one.

    Args:
        plan: of the recipe.
        names: of variants, or of poses.
    """
    if plan.recipe.compare:
        return [(a, b) for a, b in plan.recipe.compare if a in names and b in names]
    return [(names[-1], other) for other in names[:-1]]


def _depth_rows(plan: RecipePlan, outcome: Outcome, target: Target) -> list[dict[str, object]]:
    entries = {entry.name: entry for entry in plan.entries}
    names = [n for n in entries if plan.recipe.compare or n in plan.recipe.variants]
    printed = printed_rows(plan.recipe)
    rows: list[dict[str, object]] = []
    for a, b in pairs_of(plan, names):
        of_a, of_b = (
            {r.manifest.setup.protocol: r for r in outcome.results.get((name, target.name), [])}
            for name in (a, b)
        )
        for protocol in plan.recipe.protocols:
            if protocol not in of_a or protocol not in of_b:
                continue
            found = _depth_difference(of_a[protocol], of_b[protocol])
            if found is not None:
                two = (entries[a], entries[b])
                rows.append(found | _beside(target, protocol, RANKED_BY, two, found, printed))
    return rows


def _beside(
    target: Target,
    protocol: str,
    figure: str,
    two: Sequence[Entry],
    found: Mapping[str, Any],
    printed: pd.DataFrame,
) -> dict[str, object]:
    """What was compared, and the published difference by the paper's protocol."""
    published, where = nan, ""
    if protocol == _PAPERS and len(printed):
        mine = printed[printed["subset"] == found["subset"]]
        published, where = _published(mine, target.dataset, [e.published for e in two], figure)
    return {
        "test": target.name,
        "protocol": protocol,
        "figure": figure,
        "first": two[0].title,
        "second": two[1].title,
        "published": published,
        "published_on": where,
    }


def _depth_difference(first: RunResult, second: RunResult) -> dict[str, Any] | None:
    """Difference on the hardest objects that both have pixels of; None if there are none."""
    grid, _ = get_protocol(first.manifest.setup.protocol).main
    for subset in reversed(MAIN_SUBSETS):
        tables = [r.table[(r.table["grid"] == grid) & (r.table["subset"] == subset)]
                  for r in (first, second)]  # fmt: skip
        both = pd.concat([t.assign(method=i) for i, t in enumerate(tables)], ignore_index=True)
        pairs = compare_methods(both, RANKED_BY, samples=_SAMPLES)
        if len(pairs) and pairs["frames"].iloc[0] > 0:
            pair = pairs.iloc[0]
            names = ("difference", "low", "high", "frames", "scenes")
            return {"subset": subset, "p": pair["p_flip"]} | {name: pair[name] for name in names}
    return None


def _published(
    rows: pd.DataFrame, dataset: str, two: Sequence[Printed | None], figure: str
) -> tuple[float, str]:
    """The difference of two printed figures and the data set that it is of; NaN for none."""
    if len(rows) == 0 or figure not in rows:
        return nan, ""
    found = dict.fromkeys(rows["dataset"], nan)
    for name in found:
        mine = rows[rows["dataset"] == name]
        first, second = (_printed(mine, row, figure) for row in two)
        found[name] = first - second
    known = {name: value for name, value in found.items() if not isnan(value)}
    where = dataset if dataset in known else next(iter(known), "")
    return known.get(where, nan), where


def _printed(rows: pd.DataFrame, row: Printed | None, figure: str) -> float:
    if row is None:
        return nan
    mine = rows[rows["method"] == row.method]
    if "training_data" in mine:
        mine = mine[mine["training_data"] == row.training_data]
    return float(mine[figure].iloc[0]) if len(mine) else nan


def _pose_rows(plan: RecipePlan, outcome: Outcome, target: Target) -> list[dict[str, object]]:
    poses = plan.poses
    if not poses:
        return []
    printed = published_poses(plan.recipe.pose_table)
    rows: list[dict[str, object]] = []
    for a, b in pairs_of(plan, list(plan.recipe.poses)):
        two = [outcome.poses[n, target.name] for n in (a, b) if (n, target.name) in outcome.poses]
        if len(two) < 2:
            continue
        # Some tables of the paper are of all objects alone.
        is_printed = not len(printed) or SUBSET_OF[HARD] in set(printed["subset"])
        subset = HARD if is_printed and _has_hard(two[0]) else ALL
        for protocol in plan.recipe.pose_protocols:
            of_a, of_b = (score_run(r, get_pose_protocol(protocol), subset) for r in two)
            if of_a.objects != of_b.objects:
                # The paper's protocol leaves out frames without an answer: the two are not paired.
                continue
            found = compare_runs(of_a, of_b, samples=_SAMPLES)
            for figure in (f for f in POSE_FIGURES if f in found.columns):
                difference, low, high, p = found.of(figure)
                row = {
                    "subset": SUBSET_OF[subset], "difference": difference, "low": low,
                    "high": high, "p": p, "frames": found.frames, "scenes": found.scenes,
                }  # fmt: skip
                pair = (poses[a], poses[b])
                rows.append(row | _beside(target, protocol, figure, pair, row, printed))
    return rows


def _has_hard(result: PoseResult) -> bool:
    return score_run(result, get_pose_protocol(_PAPERS), HARD).objects > 0


def comparison_tables(rows: pd.DataFrame, titles: Mapping[str, str]) -> list[Table]:
    """The differences as tables, one for each test and set of objects, depth before poses.

    Args:
        rows: of `comparisons`.
        titles: of the tests, by name.
    """
    tables = []
    for test, title in titles.items():
        mine = rows[rows["test"] == test]
        for (subset, is_depth), block in mine.groupby(
            ["subset", mine["figure"] == RANKED_BY], sort=False
        ):
            frames, scenes = (int(block[name].max()) for name in ("frames", "scenes"))
            size = f"{frames} frames of {scenes} scene{'s' * (scenes != 1)}"
            what = OBJECTS[subset] if is_depth else f"poses of {_POSES_OF[subset]}"
            made = [difference_row(row) for row in block.to_dict("records")]
            heads = heads_of_differences()
            tables.append(Table(columns=heads, rows=made, title=f"{title}, {what}: {size}"))
    return tables


def heads_of_differences() -> list[Column]:
    """Columns of the cells of `difference_row`."""
    texts = ("first", "second", "figure", "protocol")
    return [
        *(Column(heading=text, numeric=False) for text in texts),
        *(Column(heading=h) for h in ("first minus second", "p", "published difference")),
        Column(heading="reading", numeric=False),
    ]


def difference_row(row: Mapping[Hashable, Any]) -> Row:
    """A row of `comparisons` as cells: millimetres of RMSE, or points of percent of poses."""
    is_depth = row["figure"] == RANKED_BY
    factor, unit = (1e3, "mm") if is_depth else (100.0, "points")

    def text(name: str, digits: int = 1) -> str:
        return number(factor * row[name], digits, signed=True)

    published = ""
    if not isnan(row["published"]):
        figure = text("published", 0 if is_depth else 1)
        published = f"{figure} {unit} ({row['published_on']})"
    return Row(
        [
            *(Cell(text=row[name]) for name in ("first", "second")),
            Cell(text="RMSE" if is_depth else heading(row["figure"])),
            Cell(text=row["protocol"]),
            Cell(
                text=f"{text('difference')} {unit}",
                note="" if isnan(row["low"]) else f"[{text('low')}, {text('high')}]",
            ),
            Cell(text="" if isnan(row["p"]) else f"{row['p']:.2g}"),
            Cell(text=published),
            Cell(text=row["reading"]),
        ]
    )
