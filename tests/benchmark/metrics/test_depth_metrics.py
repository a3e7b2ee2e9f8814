"""Depth metrics against figures worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmark.metrics import (
    FIGURES,
    NAMES,
    Missing,
    coverage,
    delta,
    depth_errors,
    mae,
    rel,
    rmse,
)
from benchmark.metrics.depth.depth_metrics import mean
from benchmark.metrics.depth.tally import tally
from std_toolkit.errors import ToolkitError

# Truth 1, 2, 4 and 0.5 m; errors +0.04, -0.4 and 0; then a hole, which costs its whole depth.
TRUE = np.array([[1.0, 2.0], [4.0, 0.5]])
PRED = np.array([[1.04, 1.6], [4.0, 0.0]])


def test_a_hole_costs_its_depth() -> None:
    assert rmse(PRED, TRUE) == pytest.approx(math.sqrt((0.0016 + 0.16 + 0 + 0.25) / 4), rel=1e-12)
    assert mae(PRED, TRUE) == pytest.approx((0.04 + 0.4 + 0 + 0.5) / 4, rel=1e-12)
    assert rel(PRED, TRUE) == pytest.approx((0.04 + 0.2 + 0 + 1) / 4, rel=1e-12)
    # Ratios 1.04, 1.25 (not below 1.25) and 1.
    assert [delta(PRED, TRUE, threshold=t) for t in (1.03, 1.05, 1.25, 1.26)] == [
        0.25,
        0.5,
        0.5,
        0.75,
    ]
    assert coverage(PRED, TRUE) == 0.75


def test_a_hole_left_out() -> None:
    out = Missing.LEFT_OUT
    assert rmse(PRED, TRUE, missing=out) == pytest.approx(math.sqrt(0.1616 / 3), rel=1e-12)
    assert mae(PRED, TRUE, missing=out) == pytest.approx(0.44 / 3, rel=1e-12)
    assert rel(PRED, TRUE, missing=out) == pytest.approx(0.08, rel=1e-12)
    assert delta(PRED, TRUE, threshold=1.26, missing=out) == 1


@pytest.mark.parametrize("bad", [-0.3, 0.0, np.nan, np.inf, -np.inf])
def test_every_unusable_prediction_costs_the_same(bad: float) -> None:
    pred = np.where(PRED == 0, bad, PRED)
    assert depth_errors(pred, TRUE) == depth_errors(PRED, TRUE)
    assert rmse(pred, TRUE) == rmse(PRED, TRUE)
    assert coverage(pred, TRUE) == 0.75


def test_negative_predictions_pass_as_given() -> None:
    pred = np.full((2, 2), -3.0)
    given = depth_errors(pred, TRUE, missing=Missing.AS_GIVEN)
    assert (given.d105, given.d125, given.coverage) == (1, 1, 0)
    assert given.mae == pytest.approx(3 + TRUE.mean())
    assert math.isnan(given.mae_answered)
    counted = depth_errors(pred, TRUE)
    assert (counted.d105, counted.d125, counted.rel) == (0, 0, 1)


def test_not_a_number_as_given_is_seen() -> None:
    pred = np.where(PRED == 0, np.nan, PRED)
    given = depth_errors(pred, TRUE, missing=Missing.AS_GIVEN)
    assert math.isnan(given.rmse)
    assert given.d105 == 0.5
    assert given.rmse_answered == pytest.approx(math.sqrt(0.1616 / 3))


@pytest.mark.parametrize("nothing", [0.0, -1.0, np.nan, np.inf])
def test_pixels_without_ground_truth_are_never_compared(nothing: float) -> None:
    true, pred = np.append(TRUE.ravel(), nothing), np.append(PRED.ravel(), 9.0)
    assert depth_errors(pred, true) == depth_errors(PRED, TRUE)
    assert rmse(pred, true) == rmse(PRED, TRUE)


def test_only_valid_pixels_are_compared() -> None:
    valid = np.array([[True, False], [True, False]])
    assert rmse(PRED, TRUE, valid) == pytest.approx(math.sqrt(0.0016 / 2))
    assert depth_errors(PRED, TRUE, valid).n_pixels == 2
    # A mask as many files have it.
    assert rmse(PRED, TRUE, valid.astype(np.uint8) * 255) == rmse(PRED, TRUE, valid)


def test_all_at_once_is_one_by_one() -> None:
    for missing in (Missing.COUNTED, Missing.AS_GIVEN):
        found = depth_errors(PRED, TRUE, missing=missing)
        alone = [f(PRED, TRUE, missing=missing) for f in (rmse, rel, mae)]
        alone += [delta(PRED, TRUE, threshold=t, missing=missing) for t in (1.05, 1.10, 1.25)]
        assert [getattr(found, n) for n in NAMES[: len(alone)]] == pytest.approx(alone, rel=1e-12)
        each = [mean(figure, PRED, TRUE, missing=missing) for figure in FIGURES]
        assert [getattr(found, n) for n in NAMES] == pytest.approx(each, rel=1e-12)


def test_nothing_to_compare() -> None:
    nothing = np.zeros((2, 2), bool)
    assert math.isnan(rmse(PRED, TRUE, nothing))
    found = depth_errors(PRED, TRUE, nothing)
    assert found.n_pixels == 0
    assert all(math.isnan(getattr(found, n)) for n in (*NAMES, "coverage"))


def test_ratios_have_the_precision_of_the_depths() -> None:
    """1.05 as float32 is not below 1.05 as float32, as in evaluations that compute in it."""
    true, pred = np.ones(1, np.float32), np.full(1, 1.05, np.float32)
    assert delta(pred, true, threshold=1.05) == 0
    assert depth_errors(pred, true).d105 == 0
    assert depth_errors(pred.astype(np.float64), true.astype(np.float64)).d105 == 1


def test_half_precision_is_read_as_single() -> None:
    true, pred = np.full(3, 0.7, np.float16), np.full(3, 0.72, np.float16)
    single = depth_errors(pred.astype(np.float32), true.astype(np.float32))
    assert depth_errors(pred, true) == single


def test_cells_do_not_touch_each_other() -> None:
    pred = np.array([1.0, np.nan, 2.0])
    found = tally(pred, np.ones(3), np.array([0, 1, 2]), 4, Missing.AS_GIVEN)
    assert found.of(np.array([0, 2])).rmse == pytest.approx(math.sqrt(0.5))
    assert math.isnan(found.of(np.array([0, 1])).rmse)
    assert found.of(np.array([3])).n_pixels == 0


def test_what_is_refused() -> None:
    with pytest.raises(ToolkitError, match="one shape"):
        rmse(PRED, TRUE[0])
    with pytest.raises(ToolkitError, match="one shape"):
        rmse(PRED, TRUE, np.ones(2, bool))
    with pytest.raises(ToolkitError, match="floating-point metres"):
        mae((PRED * 1000).astype(np.uint16), TRUE)
    with pytest.raises(ToolkitError, match="above 1"):
        delta(PRED, TRUE, threshold=1.0)
    with pytest.raises(ToolkitError, match="no way to count"):
        depth_errors(PRED, TRUE, missing=Missing.LEFT_OUT)
