"""Rates of clearing against a case worked by hand."""

import pandas as pd
import pytest

from benchmark.evaluation.results import INDEX
from benchmark.evaluation.tasks.grasp_results import completion_gain, rates_of, success_gain
from benchmark.evaluation.tasks.grasp_table import (
    ATTEMPT,
    GRASPED,
    KIND,
    LEFT,
    LOST,
    OBJECT,
    PRECISION,
)


def run_table(rounds: list[tuple[list[tuple[str, str]], list[tuple[str, int]]]]) -> pd.DataFrame:
    """A run's table of (material, fate) of objects and (outcome, held) of views per round."""
    rows = []
    for index, (objects, views) in enumerate(rounds):
        for material, fate in objects:
            rows.append({INDEX: index, KIND: OBJECT, "material": material, "fate": fate})
        for number, (outcome, held) in enumerate(views):
            first = {"found": 10 * (index + 1), "ap": 0.2 * index, "ap08": 0.1, "ap04": 0.0}
            rows.append(
                {INDEX: index, KIND: ATTEMPT, "outcome": outcome, "held": held}
                | {"executed": outcome != "no-grasp"}
                | ({"found": 3} if number else first)
            )
    columns = [INDEX, KIND, "material", "fate", "outcome", "held", "executed", "found", *PRECISION]
    table = pd.DataFrame(rows, columns=columns)
    return table.assign(executed=table["executed"].eq(True), held=table["held"].fillna(0))


TABLE = run_table(
    [
        (
            [("transparent", GRASPED), ("specular", GRASPED), ("specular", GRASPED)],
            [("held", 2), ("slipped", 0), ("held", 1)],
        ),
        (
            [("transparent", LEFT), ("specular", LOST)],
            [("blocked-by-table", 0), ("no-grasp", 0), ("no-grasp", 0), ("no-grasp", 0)],
        ),
        ([("transparent", LEFT)], [("no-grasp", 0)] * 3),
    ]
)


def test_a_hand_worked_run():
    rates = rates_of(TABLE)
    assert (rates.rounds, rates.objects, rates.attempts) == (3, 6, 4)
    assert (rates.grasped, rates.lost) == (3, 1)
    # Two of four attempts; 2/3, 0/1 and, where nothing could be tried, 0.
    assert rates.success_attempts.value == pytest.approx(2 / 4)
    assert rates.success_tables.value == pytest.approx((2 / 3 + 0 + 0) / 3)
    assert rates.completion_objects.value == pytest.approx(4 / 6)
    assert rates.completion_tables.value == pytest.approx((1 + 1 / 2 + 0) / 3)
    assert rates.cleared.value == pytest.approx(1 / 3)
    assert rates.completion_of["transparent"].value == pytest.approx(1 / 3)
    assert rates.completion_of["specular"].value == pytest.approx(1.0)
    assert rates.precision["ap"].value == pytest.approx((0.0 + 0.2 + 0.4) / 3)
    assert rates.precision["ap08"].value == pytest.approx(0.1)
    assert rates.planned == pytest.approx((10 + 20 + 30) / 3)
    assert rates.outcomes == {"blocked-by-table": 1, "held": 2, "no-grasp": 6, "slipped": 1}


def test_the_interval_holds_the_rate_and_follows_the_rounds():
    rates = rates_of(TABLE)
    for rate in (rates.completion_objects, rates.completion_tables, rates.success_attempts):
        assert rate.low <= rate.value <= rate.high
    # Whole rounds are drawn: with three tables at 1, 0.5 and 0 the ends are all or nothing.
    assert (rates.completion_tables.low, rates.completion_tables.high) == (0.0, 1.0)


def test_a_run_that_never_tried_has_no_success_per_attempt():
    nothing = run_table([([("transparent", LEFT)], [("no-grasp", 0)] * 3)])
    rates = rates_of(nothing)
    assert rates.attempts == 0
    assert rates.success_attempts.value != rates.success_attempts.value
    assert rates.success_tables.value == 0
    assert rates.completion_objects.value == 0


def test_a_gain_is_that_of_the_same_tables():
    better = run_table([([("transparent", GRASPED)] * 2, []), ([("specular", GRASPED)], [])])
    worse = run_table(
        [
            ([("transparent", GRASPED), ("transparent", LEFT)], []),
            ([("specular", GRASPED)], []),
            ([("specular", LEFT)], []),  # only one of them came to this table
        ]
    )
    gain = completion_gain(better, worse)
    assert gain.rate.value == pytest.approx((0.5 + 0) / 2)
    assert gain.rate.total == 2 and gain.p == 1.0
    glass = completion_gain(better, worse, material="transparent")
    assert glass.rate.value == pytest.approx(0.5) and glass.rate.total == 1
    assert success_gain(better, worse).rate.value == 0
