"""Tables of means over frames."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from benchmark.evaluation.tasks.depth_results import summarise
from benchmark.metrics import NAMES, DepthMetrics, Errors, Missing, depth_errors
from benchmark.metrics.significance import mean_interval
from std_toolkit.errors import ToolkitError


def image(error: float, n: int = 10, answered: int | None = None) -> Errors:
    pred = np.full(n, 1 + error)
    pred[n if answered is None else answered :] = 0
    return depth_errors(pred, np.ones(n))


def row(method: str, scene: str, index: int, errors: Errors, **more: str) -> dict[str, object]:
    return {"method": method, "scene": scene, "frame": index, **more, **errors.as_dict()}


def many(seed: int = 0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    return pd.DataFrame(
        [
            row(m, f"s{s}", i, image(float(rng.uniform(0, 0.3))), subset=subset)
            for m in ("b", "a")
            for s in range(6)
            for i in range(4)
            for subset in ("all", "edges")
        ]
    )


def test_frames_count_alike_whatever_their_pixels() -> None:
    rows = [row("raw", "s", 0, image(0.5, n=1000)), row("raw", "s", 1, image(0.0, n=2))]
    table = summarise(pd.DataFrame(rows)).iloc[0]
    assert table["mae"] == 0.25
    assert (table["frames"], table["scenes"], table["pixels"]) == (2, 1, 1002)


def test_frames_without_pixels_or_answers() -> None:
    rows = [
        row("raw", "s", 0, image(0.5)),
        row("raw", "s", 1, image(0.5, answered=0)),
        row("raw", "t", 2, depth_errors(np.ones(3), np.zeros(3))),
    ]
    table = summarise(pd.DataFrame(rows)).iloc[0]
    assert (table["frames"], table["frames_empty"], table["frames_unanswered"]) == (2, 1, 1)
    assert table["scenes"] == 1
    assert (table["mae"], table["mae_answered"], table["coverage"]) == (0.75, 0.5, 0.5)


def test_groups_without_any_frame_stay() -> None:
    nothing = depth_errors(np.ones(3), np.zeros(3))
    rows = [row("raw", "s", 0, nothing), row("swin", "s", 0, image(0.5))]
    table = summarise(pd.DataFrame(rows), samples=10)
    assert table["method"].tolist() == ["raw", "swin"]
    assert table["frames"].tolist() == [0, 1]
    assert math.isnan(table["rmse"][0]) and table["rmse"][1] == 0.5


def test_a_nan_of_a_frame_with_pixels_is_not_lost() -> None:
    broken = depth_errors(np.array([1.0, np.nan]), np.ones(2), missing=Missing.AS_GIVEN)
    table = summarise(pd.DataFrame([row("m", "s", 0, broken), row("m", "s", 1, image(0.1))]))
    assert math.isnan(table["rmse"][0])
    assert table["rmse_answered"][0] == pytest.approx(0.05)


def test_means_are_those_of_the_accumulator() -> None:
    rows = many()
    table = summarise(rows)
    assert list(zip(table["method"], table["subset"], strict=True)) == [
        ("b", "all"),
        ("b", "edges"),
        ("a", "all"),
        ("a", "edges"),
    ]
    for _, group in table.iterrows():
        metrics = DepthMetrics()
        same = rows[(rows["method"] == group["method"]) & (rows["subset"] == group["subset"])]
        for _, one in same.iterrows():
            metrics.add(Errors(**{name: one[name] for name in Errors.__dataclass_fields__}))
        for name, mean in metrics.compute().items():
            assert group[name] == pytest.approx(mean, rel=1e-12)


def test_other_groups() -> None:
    table = summarise(many(), by=("scene", "method"))
    assert len(table) == 12
    assert (table["frames"] == 8).all()


def test_intervals() -> None:
    rows = many()
    table = summarise(rows, samples=200, seed=3)
    for _, group in table.iterrows():
        same = rows[(rows["method"] == group["method"]) & (rows["subset"] == group["subset"])]
        for name in (*NAMES, "coverage"):
            one = mean_interval(same[name], same["scene"], samples=200, seed=3)
            assert group[f"{name}_low"] == pytest.approx(float(one.low), rel=1e-12)
            assert group[f"{name}_low"] <= group[name] <= group[f"{name}_high"]
    shuffled = summarise(rows.sample(frac=1, random_state=1), samples=200, seed=3)
    both = table.merge(shuffled, on=["method", "subset"], suffixes=("", "_again"))
    assert both["rmse_low"].to_numpy() == pytest.approx(both["rmse_low_again"].to_numpy())


def test_no_rows_at_all() -> None:
    nothing = many().iloc[:0]
    table = summarise(nothing, samples=5)
    assert len(table) == 0
    assert {"method", "frames", "rmse", "rmse_low", "coverage"} <= set(table.columns)


def test_what_is_refused() -> None:
    with pytest.raises(ToolkitError, match=r"coverage: rows lack columns"):
        summarise(many().drop(columns="coverage"))
    with pytest.raises(ToolkitError, match="scene: rows lack columns"):
        summarise(many().drop(columns="scene"), samples=5)
    with pytest.raises(ToolkitError, match="rows lack columns"):
        summarise(pd.DataFrame([image(0.1).as_dict()]))
