"""Intervals over scenes hold what they promise."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.metrics.significance import mean_interval, paired_test, scene_sums
from std_toolkit.errors import ToolkitError


def test_against_drawing_scene_by_scene() -> None:
    """The same interval as from lists of frames put together by hand, up to the draws' noise."""
    rng = np.random.default_rng(4)
    scenes = np.repeat(np.arange(12), rng.integers(1, 9, 12))
    values = rng.normal(scenes * 0.1, 0.05)
    by_scene = [values[scenes == s] for s in range(12)]
    means = [
        np.concatenate([by_scene[s] for s in rng.integers(0, 12, 12)]).mean() for _ in range(20_000)
    ]
    expected = np.quantile(means, [0.025, 0.975])
    found = mean_interval(values, scenes, samples=20_000)
    assert found.mean == pytest.approx(values.mean(), rel=1e-12)
    spread = expected[1] - expected[0]
    assert [found.low, found.high] == pytest.approx(expected.tolist(), abs=0.03 * spread)


def test_it_holds_the_truth_about_as_often_as_it_says() -> None:
    """30 scenes of 20 frames that go together: 200 data sets, 95 % asked for."""
    rng = np.random.default_rng(9)
    scenes = np.repeat(np.arange(30), 20)
    held = held_by_frames = 0
    for _ in range(200):
        values = rng.normal(0, 1, 30)[scenes] + rng.normal(0, 0.3, len(scenes))
        found = mean_interval(values, scenes, samples=500)
        held += bool(found.low <= 0 <= found.high)
        alone = mean_interval(values, np.arange(len(values)), samples=200)
        held_by_frames += bool(alone.low <= 0 <= alone.high)
    assert 0.88 * 200 <= held <= 200
    # What the resampling of scenes is there for.
    assert held_by_frames < 0.6 * 200


def test_figures_together_are_figures_alone() -> None:
    rng = np.random.default_rng(1)
    values, scenes = rng.random((40, 3)), rng.choice(list("abcdef"), 40)
    together = mean_interval(values, scenes, samples=300)
    for i in range(3):
        alone = mean_interval(values[:, i], scenes, samples=300)
        assert alone.low == pytest.approx(together.low[i], rel=1e-12)
        assert alone.high == pytest.approx(together.high[i], rel=1e-12)


def test_seeds_and_order_of_frames() -> None:
    rng = np.random.default_rng(1)
    values, scenes = rng.random(50), np.repeat(np.arange(10), 5)
    one = mean_interval(values, scenes, samples=500)
    order = rng.permutation(50)
    two = mean_interval(values[order], scenes[order], samples=500)
    assert one.low == pytest.approx(two.low, rel=1e-12)
    assert mean_interval(values, scenes, samples=500, seed=1).low != one.low


def test_many_scenes_are_drawn_in_parts() -> None:
    values = np.random.default_rng(0).random(6000)
    found = mean_interval(values, np.arange(6000), samples=1500)
    half = 1.96 * values.std() / np.sqrt(6000)
    assert (found.high - found.low) / 2 == pytest.approx(half, rel=0.1)


def test_one_scene_has_no_interval() -> None:
    found = mean_interval([1.0, 3.0], ["a", "a"])
    assert found.mean == 2
    assert np.isnan([found.low, found.high]).all()


def test_a_nan_is_not_lost() -> None:
    found = mean_interval([[1.0, np.nan], [1.0, 1.0]], ["a", "b"], samples=50)
    assert found.mean[0] == found.low[0] == 1
    assert np.isnan([found.mean[1], found.low[1], found.high[1]]).all()


def test_what_is_refused() -> None:
    with pytest.raises(ToolkitError, match="the scene of each"):
        mean_interval([], [])
    with pytest.raises(ToolkitError, match="the scene of each"):
        scene_sums([1.0, 2.0], ["a"])
    with pytest.raises(ToolkitError, match="level"):
        mean_interval([1.0, 2.0], ["a", "b"], level=95)


@pytest.mark.parametrize("wrong", [{"level": 1.0}, {"level": 0.0}, {"samples": 0}])
def test_an_interval_needs_a_level_below_one_and_a_sample(wrong: dict[str, float]) -> None:
    with pytest.raises(ToolkitError, match="needs a level"):
        mean_interval([1.0, 2.0], [0, 1], **wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", [(), (2, 2)])
def test_paired_figures_are_one_for_each_frame(shape: tuple[int, ...]) -> None:
    with pytest.raises(ToolkitError, match="paired figures"):
        paired_test(np.ones(shape), np.ones(shape), np.zeros(shape))
