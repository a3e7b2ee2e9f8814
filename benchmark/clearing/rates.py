"""Success and completion of table clearing, per object and per table, and how sure they are.

The paper that this experiment comes from prints a completion rate of 40 % beside 19 objects
removed of about 25; no definition gives both. So both are defined here and printed side by side:

- success, per attempt: attempts that ended with an object held / attempts, over all rounds;
- success, per table: the mean over rounds of that ratio; a round without any attempt, because the
  planner found nothing to grasp, counts 0;
- completion, per object: objects removed / objects that stood there, over all rounds;
- completion, per table: the mean over rounds of that ratio;
- tables cleared: the share of rounds in which nothing was left.

An object is removed when it is held after lifting, or lies beyond the edge of the table. Intervals
come from drawing whole rounds with replacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from benchmark.clearing.precision import PRECISION
from benchmark.clearing.table import ATTEMPT, GRASPED, KIND, LOST, OBJECT
from benchmark.metrics.bootstrap import mean_interval
from benchmark.running.parts import INDEX


@dataclass(frozen=True)
class Rate:
    """A share, with its interval of 95 %; NaN where there is nothing to count.

    Attributes:
        count, total: what was divided; for means over tables, their number in `total`.
    """

    value: float
    low: float
    high: float
    count: float
    total: int


@dataclass(frozen=True)
class Rates:
    """What a run came to.

    Attributes:
        rounds, objects, attempts: how many there were; attempts that were carried out.
        success_attempts, success_tables: see above.
        completion_objects, completion_tables, cleared: see above.
        completion_of: completion per object by material class.
        grasped, lost: objects held, and objects that left over the table's edge.
        outcomes: how often attempts ended in each way, views without a grasp among them.
        precision: means over the tables' first views of what `benchmark.clearing.precision` says.
        planned: mean number of grasps of a first view.
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
    planned: float


def rates_of(table: pd.DataFrame) -> Rates:
    """The rates of one run's table."""
    objects = table[table[KIND] == OBJECT]
    views = table[table[KIND] == ATTEMPT]
    tried = views[views["executed"]]
    removed = objects["fate"].isin([GRASPED, LOST])
    won = tried["held"] > 0
    first = views[views[PRECISION[0]].notna()]
    rounds = np.sort(objects[INDEX].unique())
    by_round = removed.groupby(objects[INDEX]).mean().reindex(rounds)
    won_by_round = won.groupby(tried[INDEX]).mean().reindex(rounds).fillna(0.0)
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
        precision={name: _rate(first[name], first[INDEX]) for name in PRECISION},
        planned=float(first["found"].mean()) if len(first) else float("nan"),
    )


def completion_gain(table: pd.DataFrame, other: pd.DataFrame) -> Rate:
    """Completion per table of a run less that of another one on the same rounds.

    Rounds that only one of them has are left out: the tables stand alike in both.
    """
    both = [_completions(t) for t in (table, other)]
    shared = both[0].index.intersection(both[1].index)
    return _rate(both[0].loc[shared] - both[1].loc[shared], shared)


def _completions(table: pd.DataFrame) -> pd.Series:
    objects = table[table[KIND] == OBJECT]
    return objects["fate"].isin([GRASPED, LOST]).groupby(objects[INDEX]).mean()


def _rate(values: pd.Series, rounds: Sequence[int] | pd.Series) -> Rate:
    numbers = np.asarray(values, dtype=np.float64)
    if not len(numbers):
        return Rate(float("nan"), float("nan"), float("nan"), 0, 0)
    found = mean_interval(numbers, np.asarray(rounds))
    return Rate(
        float(found.mean), float(found.low), float(found.high), float(numbers.sum()), len(numbers)
    )
