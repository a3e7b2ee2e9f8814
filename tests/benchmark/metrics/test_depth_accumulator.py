"""Means of depth metrics over images."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmark.metrics import DepthMetrics, Missing
from std_toolkit.errors import ToolkitError


def test_means_are_over_images_not_pixels() -> None:
    metrics = DepthMetrics()
    true = np.ones((2, 10, 10))
    valid = np.zeros((2, 10, 10), bool)
    valid[0, 0, 0] = True  # one pixel, 0.4 m off
    valid[1] = True  # a hundred, all right
    pred = true.copy()
    pred[0] = 1.4
    metrics.update(pred, true, valid)
    assert metrics.compute()["rmse"] == pytest.approx(0.2)


def test_images_without_pixels_enter_no_mean() -> None:
    metrics = DepthMetrics()
    metrics.update(np.full((4, 4), 1.5), np.ones((4, 4)))
    metrics.update(np.full((4, 4), 9.0), np.ones((4, 4)), np.zeros((4, 4), bool))
    metrics.update(np.full((4, 4), 9.0), np.zeros((4, 4)))
    assert metrics.images == 1
    assert metrics.compute()["mae"] == 0.5


def test_images_without_an_answer_enter_all_means_but_those_over_answers() -> None:
    metrics = DepthMetrics()
    metrics.update(np.full((4, 4), 1.5), np.ones((4, 4)))
    metrics.update(np.full((4, 4), np.nan), np.ones((4, 4)))
    found = metrics.compute()
    assert metrics.images == 2
    assert found["mae"] == 0.75
    assert found["coverage"] == 0.5
    assert found["mae_answered"] == 0.5


def test_a_nan_taken_as_given_is_not_lost() -> None:
    metrics = DepthMetrics(Missing.AS_GIVEN)
    metrics.update(np.array([[1.0, np.nan]]), np.ones((1, 2)))
    metrics.update(np.ones((1, 2)), np.ones((1, 2)))
    assert math.isnan(metrics.compute()["rmse"])
    assert metrics.compute()["rmse_answered"] == 0


def test_reset_and_nothing() -> None:
    metrics = DepthMetrics()
    metrics.update(np.ones((3, 3)), np.ones((3, 3)))
    metrics.reset()
    assert metrics.images == 0
    assert all(math.isnan(v) for v in metrics.compute().values())


def test_torch_and_numpy_mix() -> None:
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(2)
    true = rng.uniform(0.5, 1, (6, 8, 9)).astype(np.float32)
    pred = (true + rng.normal(0, 0.05, true.shape)).astype(np.float32)
    valid = rng.random(true.shape) < 0.5
    one, two = DepthMetrics(), DepthMetrics()
    one.update(pred, true, valid)
    two.update(*(torch.from_numpy(a[:4]) for a in (pred, true, valid)))
    two.update(pred[4], true[4], valid[4])
    two.update(*(torch.from_numpy(a[5]) for a in (pred, true, valid)))
    assert one.images == two.images == 6
    assert list(one.compute().values()) == pytest.approx(list(two.compute().values()), rel=1e-12)


def test_states_add_as_processes_do() -> None:
    parts = [DepthMetrics() for _ in range(3)]
    for i, part in enumerate(parts):
        part.update(np.full((2, 2), 1.0 + i), np.ones((2, 2)))
    whole = DepthMetrics()
    whole.merge_state(np.sum([p.state for p in parts], axis=0))
    assert whole.images == 3
    assert whole.compute()["mae"] == 1.0
    whole.state[:] = 0  # a copy
    assert whole.images == 3


def test_what_is_refused() -> None:
    metrics = DepthMetrics()
    with pytest.raises(ToolkitError, match="H, W"):
        metrics.update(np.ones(3), np.ones(3))
    with pytest.raises(ToolkitError, match="one shape"):
        metrics.update(np.ones((2, 3)), np.ones((3, 2)))
    with pytest.raises(ToolkitError, match="one shape"):
        metrics.update(np.ones((2, 3)), np.ones((2, 3)), np.ones((1, 2, 3), bool))
    with pytest.raises(ToolkitError, match="another way"):
        metrics.merge(DepthMetrics(Missing.AS_GIVEN))
    with pytest.raises(ToolkitError, match="not a state"):
        metrics.merge_state(np.zeros(3))
    with pytest.raises(ToolkitError, match="no way to count"):
        DepthMetrics(Missing.LEFT_OUT)
    assert metrics.images == 0
