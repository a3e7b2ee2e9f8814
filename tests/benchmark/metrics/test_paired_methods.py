"""Significance of differences between methods."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pandas as pd
import pytest
from scipy.stats import wilcoxon

from benchmark.metrics import flips
from benchmark.metrics.significance import compare_methods, holm, paired_test
from std_toolkit.errors import ToolkitError


def frames(scenes: int = 10, each: int = 6, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    of = np.repeat(np.arange(scenes), each)
    return rng.normal(1, 0.2, scenes)[of] + rng.normal(0, 0.02, len(of)), of


def test_flips_against_counting_them_one_by_one() -> None:
    first, scenes = frames(7)
    second = first - np.random.default_rng(3).normal(0.02, 0.05, 7)[scenes]
    difference = first - second
    sums = [difference[scenes == s].sum() for s in range(7)]
    reached = sum(
        abs(np.dot(signs, sums)) >= abs(sum(sums)) - 1e-12 for signs in product((-1, 1), repeat=7)
    )
    found = paired_test(first, second, scenes)
    assert found.p_flip == pytest.approx(reached / 2**7)
    means = [difference[scenes == s].mean() for s in range(7)]
    assert found.p_wilcoxon == pytest.approx(wilcoxon(means).pvalue)
    assert found.difference == pytest.approx(difference.mean())
    assert (found.frames, found.scenes) == (42, 7)


def test_drawn_flips_are_near_the_counted_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    first, scenes = frames(12)
    second = first - np.random.default_rng(1).normal(0.01, 0.05, 12)[scenes]
    counted = paired_test(first, second, scenes).p_flip
    assert 0.02 < counted < 0.98
    monkeypatch.setattr("benchmark.metrics.flips.EXACT_SCENES", 3)
    assert paired_test(first, second, scenes).p_flip == pytest.approx(counted, abs=0.02)


def test_five_scenes_can_not_be_significant() -> None:
    first, scenes = frames(5)
    found = paired_test(first, first - 1, scenes)
    assert found.p_flip == 2 / 2**5
    assert found.low == pytest.approx(1)


def test_false_alarms_are_as_rare_as_promised() -> None:
    """Two methods that differ by chance alone, scene by scene: p below 0.05 in about 5 %."""
    rng = np.random.default_rng(8)
    scenes = np.repeat(np.arange(10), 5)
    alarms = 0
    for _ in range(300):
        difference = rng.normal(0, 1, 10)[scenes] + rng.normal(0, 0.1, 50)
        alarms += paired_test(difference, np.zeros(50), scenes, samples=2).p_flip < 0.05
    assert alarms <= 0.09 * 300


def test_no_difference() -> None:
    first, scenes = frames()
    found = paired_test(first, first, scenes)
    assert (found.difference, found.p_flip, found.p_wilcoxon) == (0, 1, 1)


def test_holm_by_hand() -> None:
    # 4 * .005, 3 * .011, 2 * .02, then .04 stays under the .04 before it.
    assert holm([0.04, 0.011, 0.005, 0.02]) == pytest.approx([0.04, 0.033, 0.02, 0.04])
    assert holm([0.7, 0.6]).tolist() == [1, 1]
    assert holm([0.01, np.nan, 0.04]) == pytest.approx([0.02, np.nan, 0.04], nan_ok=True)
    assert holm([]).size == 0


def rows(**methods: np.ndarray) -> pd.DataFrame:
    _, scenes = frames()
    parts = [
        pd.DataFrame(
            {"method": name, "scene": scenes, "frame": np.arange(len(scenes)), "rmse": values}
        )
        for name, values in methods.items()
    ]
    return pd.concat(parts, ignore_index=True)


def test_every_two_methods() -> None:
    first, scenes = frames()
    table = rows(swin=first, raw=first + 0.5, nlspn=first + np.where(scenes % 2, 1e-3, -1e-3))
    shuffled = table[table["method"] != "swin"].sample(frac=1, random_state=0)
    found = compare_methods(pd.concat([table[table["method"] == "swin"], shuffled]))
    assert set(zip(found["first"], found["second"], strict=True)) & {("swin", "raw")}
    assert len(found) == 3
    raw = found[(found["first"] == "swin") & (found["second"] == "raw")].iloc[0]
    assert raw["difference"] == pytest.approx(-0.5)
    assert raw["p_flip"] == 2 / 2**10
    assert raw["p_flip_holm"] == pytest.approx(3 * 2 / 2**10)
    same = found[found["difference"].abs() < 0.01].iloc[0]
    assert same["p_flip"] > 0.5
    assert (found["unpaired"] == 0).all()


def test_frames_that_one_method_lacks_are_counted() -> None:
    first, _ = frames()
    table = rows(a=first, b=first + 0.1)
    table = table.drop(index=[0, 1])
    table.loc[table.index[-1], "rmse"] = np.nan
    found = compare_methods(table).iloc[0]
    assert (found["frames"], found["unpaired"]) == (57, 3)


def test_methods_without_a_common_frame() -> None:
    first, _ = frames()
    table = rows(a=first, b=first, c=first)
    table.loc[table["method"] == "b", "frame"] += 1000
    found = compare_methods(table).set_index(["first", "second"])
    assert np.isnan(found.loc[("a", "b"), "p_flip"])
    assert found.loc[("a", "b"), "unpaired"] == 120
    assert found.loc[("a", "c"), "p_flip_holm"] == 1


def test_what_is_refused() -> None:
    first, scenes = frames()
    with pytest.raises(ToolkitError, match="finite, and as many"):
        paired_test(first, np.append(first[1:], np.nan), scenes)
    with pytest.raises(ToolkitError, match="lack columns"):
        compare_methods(rows(a=first), "d105")
    twice = pd.concat([rows(a=first), rows(a=first)])
    with pytest.raises(ToolkitError, match="twice for one method"):
        compare_methods(twice)


def test_the_least_p_of_drawn_flips_counts_what_was_observed() -> None:
    sums = np.linspace(1.0, 1.5, 40)
    found = flips.flip_test(sums)
    assert found == 1 / (flips.FLIPS + 1)


@pytest.mark.parametrize("scenes", [2, 6, 15, 20])
def test_all_pairs_at_once_have_the_p_of_single_tests(scenes: int) -> None:
    """With ties, equal methods, and methods that lack frames."""
    rng = np.random.default_rng(scenes)
    of = np.repeat(np.arange(scenes), 2)
    values = rng.normal(1, 0.2, (len(of), 7))
    values[:, 4:] = np.round(values[:, 4:] * 4) / 4
    values[:, 3] = values[:, 0]
    values[0, 1] = values[-1, 5] = np.nan
    found = flips.flip_tests(values, of)
    for i, j in combinations(range(7), 2):
        both = ~np.isnan(values[:, i] + values[:, j])
        alone = paired_test(values[both, i], values[both, j], of[both], samples=2).p_flip
        assert found[i, j] == found[j, i] == alone


def test_without_intervals_the_corrected_p_is_the_same() -> None:
    first, scenes = frames()
    table = rows(swin=first, raw=first + 0.5, nlspn=first + np.where(scenes % 2, 1e-3, -1e-3))
    whole, quick = compare_methods(table, samples=50), compare_methods(table, samples=0)
    same = ["first", "second", "p_flip", "p_flip_holm"]
    assert quick[same].equals(whole[same])
