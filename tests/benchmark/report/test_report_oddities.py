"""Reports on results that are not as one config: unfinished, empty, many methods, long names."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pandas as pd
import pytest

from benchmark.cli.report import main
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.results import TABLE
from benchmark.evaluation.tasks.depth_results import read_results
from benchmark.report.leaderboard import MEASURED, PUBLISHED, make_board, one_of_each
from benchmark.report.parts.depth_plots import bars, method_colors, radar
from benchmark.report.parts.depth_tables import can_differ
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import SPLIT, a_run, published_as, write_split
from tests.dreds_on_disk import write_std_scene

JOBS = JobOptions(engine="serial", progress=False)


@pytest.fixture
def results(tmp_path: Path) -> Path:
    root = write_split(tmp_path / "data", scenes=2, frames=2)
    runs = [
        a_run(root, tmp_path / "r", m, gallery=False, protocol="paper") for m in ("raw", "nearest")
    ]
    with published_as(4, 2):
        run_all(runs, JOBS)
    return tmp_path / "r"


def test_bars_show_each_figure_once_and_as_it_is(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    rows = board.main_rows(SPLIT, "paper")
    assert rows["method"].duplicated().any()  # a paper prints SwinDRNet in several tables
    text = bars(rows, method_colors(board))
    assert text is not None
    traces = json.loads(text)["data"]
    drawn = [(name, x) for t in traces for name, x in zip(t["customdata"], t["x"], strict=True)]
    assert len({name for name, _ in drawn}) == len(drawn)
    places = [y for t in traces for y in t["y"]]
    assert sorted(places) == list(range(len(drawn)))
    paper = rows[rows["table"].fillna("").str.contains("state of the art")]
    for row in paper.itertuples():
        assert (f"{row.method} (published)", pytest.approx(row.rmse * 1e3)) in drawn


def test_a_paper_method_is_kept_from_its_comparison() -> None:
    rows = pd.DataFrame(
        {
            "method": ["A", "A", "A", "B"],
            "kind": [PUBLISHED, PUBLISHED, MEASURED, PUBLISHED],
            "table": ["supplement: x", "main: comparison", None, "supplement: x"],
            "training_data": ["", "", None, ""],
        }
    )
    assert one_of_each(rows).index.tolist() == [1, 2, 3]


def test_the_radar_stays_readable(results: Path) -> None:
    board = make_board(read_results([results]), published=False, samples=50)
    one = board.main_rows(SPLIT, "paper").iloc[[0]]
    many = pd.concat([one.assign(method=f"{i}-{'long' * 20}") for i in range(20)])
    colors = dict.fromkeys(many["method"], "#123456")
    text = radar(many, colors)
    assert text is not None
    traces = json.loads(text)["data"]
    assert len(traces) == 8
    assert max(len(t["name"]) for t in traces) < 40
    assert len({t["line"]["dash"] for t in traces}) == 3  # one colour for all: dashes differ


@pytest.mark.parametrize(("methods", "scenes"), [(2, 6), (5, 9), (20, 13)])
def test_what_the_test_can_tell_apart(methods: int, scenes: int) -> None:
    assert can_differ(scenes, methods)
    assert not can_differ(scenes - 1, methods)


def test_unfinished_runs_are_told(results: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = results / SPLIT / "raw" / "paper" / TABLE
    table = pd.read_parquet(path)
    table[table["index"] < 3].to_parquet(path)
    (results / SPLIT / "nearest" / "paper" / TABLE).unlink()
    with caplog.at_level(logging.WARNING, logger="std_toolkit"):
        (raw,) = read_results([results])
    assert raw.missing == 1
    assert "1 of 4 frames are missing" in caplog.text
    assert "nearest/paper: not finished, left out" in caplog.text


def test_nothing_finished_says_how_to_go_on(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in results.rglob(TABLE):
        path.unlink()
    assert main([str(results)]) == 1
    error = capsys.readouterr().err
    assert "no finished run here" in error
    assert "to go on" in error


def test_a_table_without_a_column_is_named(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = results / SPLIT / "raw" / "paper" / TABLE
    pd.read_parquet(path).drop(columns="rmse").to_parquet(path)
    assert main([str(results)]) == 1
    assert f"error: {path}: rmse: the table lacks columns" in capsys.readouterr().err


def test_frames_without_any_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from benchmark.cli.bench import main as bench

    write_std_scene(tmp_path / "data" / "STD-CatKnown" / "scene", balls=())
    out = tmp_path / "r"
    words = ["--method", "raw", "--data", str(tmp_path / "data"), "--split", SPLIT]
    assert bench([*words, "--out", str(out), "--engine", "serial", "--no-speed"]) == 0
    assert "no frame has a pixel to compare" in capsys.readouterr().out
    assert main([str(out)]) == 1
    assert "nothing to report" in capsys.readouterr().err
