"""Pictures of a few frames: which frames, and what their colours say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from benchmark.evaluation.depth_panels import (
    LARGEST_ERROR_M,
    PANELS,
    DepthScale,
    depth_picture,
    error_picture,
)
from benchmark.evaluation.engine import run_task
from benchmark.evaluation.tasks.depth_pictures import FOLDER, gallery_frames, make_gallery
from std_toolkit.io.images import read_color
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import a_run, write_split


def rows(values: list[float], pixels: int = 9) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "index": i,
                "grid": "g",
                "subset": "all",
                "error": "",
                "n_pixels": pixels,
                "rmse": value,
            }
            for i, value in enumerate(values)
        ]
    )


def test_no_pictures_of_failed_frames_alone() -> None:
    table = rows([0.1, 0.2]).drop(columns="rmse").assign(grid="", error="cannot be read")
    assert gallery_frames(table, ("g", "all"), [0, 1]) == []


def test_best_median_worst_and_what_all_show() -> None:
    shown = gallery_frames(rows([0.3, 0.1, 0.5, 0.2, 0.4]), ("g", "all"), [0, 2])
    assert shown == [
        ("best", 1, 0.1),
        ("median", 0, 0.3),
        ("worst", 2, 0.5),
        ("common", 0, 0.3),
        ("common", 2, 0.5),
    ]


def test_nothing_to_show_where_nothing_was_scored() -> None:
    assert gallery_frames(rows([0.1], pixels=0), ("g", "all"), [0]) == []


def test_the_pictures_of_a_run(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=1, frames=3)
    run = a_run(root, tmp_path / "out")
    run_task(run, JobOptions(engine="serial", progress=False))
    gallery = make_gallery(run, run.protocol)
    assert [p.rank for p in gallery.pictures][:3] == ["best", "median", "worst"]
    values = [p.rmse for p in gallery.pictures[:3]]
    assert values == sorted(values)
    picture = read_color(run.folder / FOLDER / gallery.pictures[0].picture)
    assert picture.shape[1] == len(PANELS) * 320 + (len(PANELS) - 1) * 4


def test_trust_in_the_sensor_is_shown_of_methods_that_tell_it(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=1, frames=3)
    run = a_run(root, tmp_path / "out", "tests.benchmark.evaluation.bench_set:Trusting")
    run_task(run, JobOptions(engine="serial", progress=False))
    for shown in make_gallery(run, run.protocol).pictures:
        assert shown.trust == (shown.rank != "common")
        picture = read_color(run.folder / FOLDER / shown.picture)
        panels = 6 if shown.trust else 5
        assert picture.shape[1] == panels * 320 + (panels - 1) * 4
        if shown.trust:
            last = picture[:, -320:].astype(int)
            assert last[:, :150].min() > 200, "trusted is light"
            assert last[:, 170:].max() < 40, "not trusted is dark"


def test_error_colours_tell_missed_from_wrong() -> None:
    true = np.array([[1.0, 1.0, 1.0, 0.0]], np.float32)
    restored = np.array([[1.0, 1 + LARGEST_ERROR_M, 0.0, 1.0]], np.float32)
    right, wrong, missed, unknown = error_picture(restored, true)[0].astype(int)
    assert right.sum() < 30, "no error is black"
    assert wrong.sum() > 500, "the largest error is bright"
    assert missed[2] > missed[1] and missed[0] > missed[1], "missed is violet"
    assert len({tuple(c) for c in (right, wrong, missed, unknown)}) == 4


def test_near_is_bright() -> None:
    near, far, nothing = depth_picture(
        np.array([[0.5, 0.9, 0.0]], np.float32), DepthScale(0.5, 0.9)
    )[0].astype(int)
    assert near.sum() > far.sum() > nothing.sum()
