"""Figures of papers, as printed."""

from __future__ import annotations

import numpy as np

from benchmark.data.splits import splits
from benchmark.published.load import (
    SPLIT_OF,
    published_depth,
    published_rows,
    published_speed,
)


def figure(method: str, split: str, subset: str, table: str) -> dict[str, float]:
    rows = published_depth()
    found = rows[
        (rows["method"] == method)
        & (rows["split"] == split)
        & (rows["subset"] == subset)
        & rows["table"].str.contains(table)
    ]
    assert len(found) == 1
    return found.iloc[0].to_dict()


def test_the_main_comparison_is_there() -> None:
    ours = figure("SwinDRNet", "std-catknown", "specular+transparent", "comparison")
    assert ours["rmse"] == 0.018
    assert np.isclose(ours["d105"], 0.9497)
    assert figure("NLSPN", "std-catknown", "all", "comparison")["rmse"] == 0.114


def test_a_column_for_both_stands_for_both() -> None:
    both = [
        figure("LIDF", "std-catnovel", s, "comparison") for s in ("all", "specular+transparent")
    ]
    assert both[0]["mae"] == both[1]["mae"] == 0.031


def test_nothing_is_made_up() -> None:
    """As many figures as the file has; those for both columns count twice."""
    rows = published_rows()
    tasks = ("depth_restoration", "monocular_depth")
    depth = rows[rows["task"].isin(tasks) & rows["dataset"].isin(SPLIT_OF)]
    twice = int((depth["subset"] == "all_and_specular_transparent").sum())
    figures = published_depth()[["rmse", "rel", "mae", "d105", "d110", "d1118", "d125"]]
    assert figures.notna().sum().sum() == len(depth) + twice
    assert len(rows) == 550 + 258


def test_they_belong_to_splits_that_there_are() -> None:
    known = {*splits.names(), *(f"hammer-{sensor}-test" for sensor in ("d435", "l515", "tof"))}
    assert set(published_depth()["split"]) <= known


def test_speed_in_frames_per_second() -> None:
    assert published_speed()["SwinDRNet"] == 30
