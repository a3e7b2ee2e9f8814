"""Results of table clearing: reading, success and completion rates with intervals, the tables.

The paper of this experiment prints a completion rate of 40 % and 19 removed objects of about 25; no
definition gives both. Rates are therefore computed per object and per table:

- success, per attempt: attempts that ended with an object held / attempts, over all rounds;
- success, per table: the mean over rounds of that ratio; a round without an attempt, because the
  planner found no grasp, counts as 0;
- completion, per object: removed objects / objects at the start, over all rounds;
- completion, per table: the mean over rounds of that ratio;
- tables cleared: the fraction of rounds in which no object was left.

An object is removed if it is held after lifting, or is beyond the edge of the table. Intervals are
computed by resampling whole rounds with replacement.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmark.data.identity import answers_digest
from benchmark.evaluation.manifest import GRASP_MANIFEST, GraspManifest
from benchmark.evaluation.results import (
    INDEX,
    Result,
    check_columns,
    find_runs,
    read_known,
    read_table,
)
from benchmark.evaluation.tasks.grasp_table import (
    ATTEMPT,
    ATTEMPTS,
    GRASPED,
    KIND,
    LOST,
    OBJECT,
    PRECISION,
)
from benchmark.metrics.grasp.gripper import PANDA
from benchmark.metrics.significance import mean_interval, paired_test
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import text_table
from std_toolkit.io.documents import read_document

# Camera, seed, planner and depth of a run, as shown in tables.
RunName = tuple[str, int, str, str]

HEADINGS = (
    "planner", "depth", "rounds", "grasped / attempts", "success % per attempt", "per table",
    "removed / objects", "completion % per object", "per table", "tables cleared %",
    "transparent %", "specular %",
)  # fmt: skip


PLAN_HEADINGS = (
    "planner", "depth", "views", "grasps of a view", "AP %", "AP0.8 %", "AP0.4 %",
)  # fmt: skip


@dataclass(frozen=True)
class Rate:
    """A fraction with its 95 % interval; NaN if `total` is 0.

    Attributes:
        count, total: numerator and denominator; for means over tables, `total` is their number.
    """

    value: float
    low: float
    high: float
    count: float
    total: int


@dataclass(frozen=True)
class Rates:
    """Rates of a run.

    Attributes:
        rounds, objects, attempts: their numbers; only executed attempts count.
        success_attempts, success_tables: success, see the module.
        completion_objects, completion_tables, cleared: completion, see the module.
        completion_of: completion per object by material class.
        grasped, lost: number of objects held, and of objects beyond the edge of the table.
        outcomes: number of attempts by outcome, including views without a grasp.
        precision: means over the first views of the tables, columns of `grasp_table`; NaN of a
            gripper for which it is not defined.
        views: number of first views.
        planned: mean number of grasps planned on one.
    """

    rounds: int
    objects: int
    attempts: int
    success_attempts: Rate
    success_tables: Rate
    completion_objects: Rate
    completion_tables: Rate
    cleared: Rate
    completion_of: dict[str, Rate]
    grasped: int
    lost: int
    outcomes: dict[str, int]
    precision: dict[str, Rate]
    views: int
    planned: float


def rates_of(table: pd.DataFrame) -> Rates:
    """Compute the rates from the table of a run."""
    objects = table[table[KIND] == OBJECT]
    views = table[table[KIND] == ATTEMPT]
    tried = views[views["executed"]]
    removed = objects["fate"].isin([GRASPED, LOST])
    won = tried["held"] > 0
    first = views.drop_duplicates(INDEX)
    judged = first[first[PRECISION[0]].notna()]
    rounds = np.sort(objects[INDEX].unique())
    by_round = removed.groupby(objects[INDEX]).mean().reindex(rounds)
    won_by_round = _successes(table)
    return Rates(
        rounds=len(rounds),
        objects=len(objects),
        attempts=len(tried),
        success_attempts=_rate(won, tried[INDEX]),
        success_tables=_rate(won_by_round, rounds),
        completion_objects=_rate(removed, objects[INDEX]),
        completion_tables=_rate(by_round, rounds),
        cleared=_rate(by_round == 1.0, rounds),
        completion_of={
            str(name): _rate(part, objects.loc[part.index, INDEX])
            for name, part in removed.groupby(objects["material"])
        },
        grasped=int((objects["fate"] == GRASPED).sum()),
        lost=int((objects["fate"] == LOST).sum()),
        outcomes={str(k): int(n) for k, n in views["outcome"].value_counts().sort_index().items()},
        precision={name: _rate(judged[name], judged[INDEX]) for name in PRECISION},
        views=len(first),
        planned=float(first["found"].mean()) if len(first) else float("nan"),
    )


@dataclass(frozen=True)
class Gain:
    """A rate per table of a run minus that of another run on the same tables.

    Attributes:
        rate: the difference; its total is the number of tables that both have.
        p: of the sign-flip test over tables, see `benchmark.metrics.significance.paired_test`;
            NaN without a table.
    """

    rate: Rate
    p: float


def completion_gain(
    table: pd.DataFrame, other: pd.DataFrame, *, material: str | None = None
) -> Gain:
    """Compare completion per table of two runs.

    Rounds that only one of them has are skipped, so that both have the same tables.

    Args:
        table, other: of the runs.
        material: only of objects of this class, on tables that have one; None for all.
    """
    return _gain(*(_completions(t, material) for t in (table, other)))


def success_gain(table: pd.DataFrame, other: pd.DataFrame) -> Gain:
    """The same for success per table; a table without an attempt counts 0."""
    return _gain(*(_successes(t) for t in (table, other)))


def _gain(mine: pd.Series, others: pd.Series) -> Gain:
    shared = mine.index.intersection(others.index)
    a, b = mine.loc[shared].astype(float), others.loc[shared].astype(float)
    p = paired_test(a, b, shared).p_flip if len(shared) else float("nan")
    return Gain(_rate(a - b, shared), p)


def _completions(table: pd.DataFrame, material: str | None = None) -> pd.Series:
    objects = table[table[KIND] == OBJECT]
    if material is not None:
        objects = objects[objects["material"] == material]
    return objects["fate"].isin([GRASPED, LOST]).groupby(objects[INDEX]).mean()


def _successes(table: pd.DataFrame) -> pd.Series:
    views = table[table[KIND] == ATTEMPT]
    tried = views[views["executed"]]
    rounds = np.sort(table[INDEX].unique())
    return (tried["held"] > 0).groupby(tried[INDEX]).mean().reindex(rounds).fillna(0.0)


def _rate(values: pd.Series, rounds: Sequence[int] | pd.Series) -> Rate:
    numbers = np.asarray(values, dtype=np.float64)
    if not len(numbers):
        return Rate(float("nan"), float("nan"), float("nan"), 0, 0)
    found = mean_interval(numbers, np.asarray(rounds))
    return Rate(
        float(found.mean), float(found.low), float(found.high), float(numbers.sum()), len(numbers)
    )


@dataclass(frozen=True, eq=False)
class GraspResult(Result[GraspManifest]):
    """A planner on a depth; see `benchmark.evaluation.tasks.grasp_table`.

    Attributes:
        rates: rates of the run.
        saved_depth: digest of all saved depth that the rounds had; "" for other depth.
    """

    rates: Rates
    saved_depth: str = ""

    @property
    def name(self) -> RunName:
        setup = self.manifest.setup
        tool = "" if setup.gripper == PANDA.name else setup.gripper
        shown = ", ".join(filter(None, (setup.camera, setup.meshes, setup.scenes, tool)))
        return shown, setup.seed, self.manifest.planner_label, self.manifest.depth_label

    @property
    def title(self) -> str:
        camera, seed, planner, depth = self.name
        return f"{planner} on {depth} depth, {camera} camera, seed {seed}"

    @property
    def frames(self) -> int:
        """Number of finished rounds: more may always be added."""
        return self.rates.rounds


def read_grasp_run(folder: Path, *, rounds: int | None = None) -> GraspResult:
    """Read the results of one run.

    Args:
        folder: folder of the run.
        rounds: use only the first `rounds` rounds; None for all.

    Raises:
        ToolkitError: a file is missing or damaged, or no round is finished.
    """
    manifest = read_document(folder / GRASP_MANIFEST, GraspManifest)
    path = folder / ATTEMPTS
    table = read_table(path)
    needed = (INDEX, KIND, "fate", "outcome", "held", "found", *PRECISION)
    check_columns(table, needed, path)
    if rounds is not None:
        table = table[table[INDEX] < rounds]
    if table.empty:
        raise ToolkitError("no round is finished", path=path)
    content = read_known(folder).content
    saved = "" if content is None else answers_digest(content)
    return GraspResult(folder, manifest, table, rates_of(table), saved)


def read_grasp_results(folders: Iterable[Path]) -> list[GraspResult]:
    """Read all finished runs of table clearing below some folders, in a fixed order.

    Raises:
        ToolkitError: there is none, a run is damaged, or two runs have the same name.
    """
    return find_runs(folders, GRASP_MANIFEST, ATTEMPTS, read_grasp_run)


def grasp_table(results: Sequence[GraspResult]) -> str:
    """Format tables of clearing and planning, a line per run; 95 % intervals in brackets."""
    blocks = []
    for camera, seed in dict.fromkeys(r.name[:2] for r in results):
        mine = [r for r in results if r.name[:2] == (camera, seed)]
        title = f"table clearing, {camera} camera, seed {seed}"
        blocks.append(text_table(HEADINGS, map(cells, mine), title=title))
        title = "grasps planned on the first view of each table"
        blocks.append(text_table(PLAN_HEADINGS, map(plan_cells, mine), title=title))
    return "\n\n".join(block.terminal() for block in blocks)


def grasp_records(results: Sequence[GraspResult]) -> list[dict[str, Any]]:
    """Return the figures of `grasp_table`, as fractions."""
    names = ("camera", "seed", "planner", "depth")
    return [{**dict(zip(names, r.name, strict=True)), **asdict(r.rates)} for r in results]


def cells(result: GraspResult) -> list[str]:
    """Return the cells of a run in the order of `HEADINGS`."""
    r = result.rates
    removed = r.grasped + r.lost
    lost = f" ({r.lost} off)" if r.lost else ""
    return [
        result.manifest.planner_label,
        result.manifest.depth_label,
        str(r.rounds),
        f"{int(r.success_attempts.count)} / {r.attempts}",
        share(r.success_attempts),
        share(r.success_tables),
        f"{removed} / {r.objects}{lost}",
        share(r.completion_objects),
        share(r.completion_tables),
        share(r.cleared),
        share(r.completion_of.get("transparent")),
        share(r.completion_of.get("specular")),
    ]


def plan_cells(result: GraspResult) -> list[str]:
    """Return the cells of a run in the order of `PLAN_HEADINGS`."""
    r = result.rates
    return [
        result.manifest.planner_label,
        result.manifest.depth_label,
        str(r.views),
        f"{r.planned:.1f}",
        *(share(r.precision[name]) for name in PRECISION),
    ]


def share(rate: Rate | None) -> str:
    """Format a rate in percent, with its interval if there is one.

    >>> share(Rate(0.5, 0.25, 0.75, 3, 6)), share(None)
    ('50.0 [25.0, 75.0]', '-')
    """
    if rate is None or math.isnan(rate.value):
        return "-"
    if math.isnan(rate.low):
        return f"{100 * rate.value:.1f}"
    return f"{100 * rate.value:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"
