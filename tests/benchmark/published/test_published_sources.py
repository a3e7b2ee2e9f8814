"""Published figures: open sources, one unit a metric, no two protocols in one table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.evaluation.evaluate import run_all
from benchmark.evaluation.tasks.depth_results import read_results
from benchmark.published import load
from benchmark.report.leaderboard import PUBLISHED, make_board
from benchmark.report.page import make_parts, render_page
from benchmark.report.parts.published import TASKS, published_records, published_tables
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import a_run, published_as, write_split

EVERY = sum(TASKS.values(), ())
HIDDEN = {"clearpose-notes": 17, "reproduction-log": 16, "d3roma-notes": 13}


@pytest.fixture
def sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A copy of the list of sources that the loader reads."""
    path = tmp_path / "published_sources.csv"
    path.write_bytes(load._SOURCES_FILE.read_bytes())
    monkeypatch.setattr(load, "_SOURCES_FILE", path)
    for cached in (load.published_sources, load.every_row):
        monkeypatch.setattr(load, cached.__name__, cached.__wrapped__)
    return path


def test_every_shown_figure_has_a_source_that_can_be_opened() -> None:
    rows = load.published_rows()
    assert rows["address"].str.match(r"https://(arxiv\.org|github\.com|pypi\.org)/").all()
    assert rows["trust"].isin(load.GRADES).all()
    for keys in load.published_bop()["source"]:
        for key in keys.split(";"):
            assert load.cited([key]).count("https://") == 1
    every = load.every_row()
    assert every[every["address"] == ""]["source"].value_counts().to_dict() == HIDDEN
    shown = {record["source"] for record in published_records(EVERY)}
    assert shown.isdisjoint(HIDDEN) and len(published_records(EVERY)) == len(rows)


@pytest.mark.parametrize(
    "address",
    [
        "notes of 2026-08-26", "http://arxiv.org/abs/2512.23705", "https://arxiv.org/abs/DKT",
        "https://github.com/Galaxies99/TransCG/blob/main/assets/docs/DFNet.md",
        "file:///home/me/table.csv", "https://drive.google.com/file/d/1APIuzIQmFucDP4RcmiNV",
    ],
)  # fmt: skip
def test_a_source_that_a_reader_cannot_open_is_refused(sources: Path, address: str) -> None:
    text = sources.read_text()
    assert len(load.published_rows())
    sources.write_text(text.replace("https://arxiv.org/abs/2512.23705", address))
    with pytest.raises(ToolkitError, match=r"published_sources\.csv: dkt") as told:
        load.published_rows()
    assert address in str(told.value)


def test_a_source_that_loses_its_address_is_hidden(sources: Path) -> None:
    before = len(load.published_rows())
    sources.write_text(sources.read_text().replace("https://arxiv.org/abs/2509.02530", ""))
    assert len(load.published_rows()) == before - 98
    sources.write_text(sources.read_text().replace("paper text", "hearsay"))
    with pytest.raises(ToolkitError, match="unknown grade"):
        load.published_rows()


def test_a_figure_without_a_source_is_refused(
    sources: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = load.every_row()
    path = sources.with_name("published_results.csv")
    rows.iloc[:3].assign(source="somewhere").to_csv(path, index=False)
    monkeypatch.setattr(load, "_FILE", path)
    with pytest.raises(ToolkitError, match=r"published_results\.csv.*somewhere"):
        load.published_rows()


@pytest.mark.parametrize(
    ("metric", "value", "ours"),
    [
        ("rmse_cm", "14.02", ("rmse", 0.1402)),  # centimetres
        ("rmse_m", "0.1458", ("rmse", 0.1458)),
        ("l1_m", "0.0550", ("mae", 0.055)),
        ("rel_pct", "12.38", ("rel", 0.1238)),  # percent
        ("rel", "0.0708", ("rel", 0.0708)),
        ("delta_1.10_pct", "51.39", ("d110", 0.5139)),
        ("delta_1.25^0.5_pct", "91.79", ("d1118", 0.9179)),  # 1.118 is not 1.10
        ("success_rate", "0.384", ("success_rate", 0.384)),
        ("success_rate_pct", "38.78", ("success_rate", 0.3878)),
        ("5deg2cm_pct", "53.3", ("5deg2cm", 0.533)),
        ("seconds_per_frame", "0.151", ("frames_per_s", 1 / 0.151)),
        ("ms_per_frame", "13370", ("frames_per_s", 1 / 13.37)),
        ("fps", "30", ("frames_per_s", 30)),
    ],
)
def test_one_unit_a_metric(metric: str, value: str, ours: tuple[str, float]) -> None:
    name, number = load.in_our_unit(metric, value)
    assert (name, number) == (ours[0], pytest.approx(ours[1], rel=1e-12))


def test_figures_are_plausible_in_their_unit() -> None:
    """A metric in the wrong unit is off by 10 or more: all figures of it lie within bounds."""
    rows = pd.DataFrame(published_records(EVERY))
    bounds = {"rmse": (0.005, 0.7), "mae": (0.004, 0.6), "rel": (0.005, 1.0)}
    for name, block in rows.groupby("metric"):
        low, high = bounds.get(name, (0.0, 1.0))
        if name not in ("frames_per_s", "attempts", "objects_grasped"):
            assert block["value"].between(low, high).all(), name
    hammer = rows[rows["dataset"].str.startswith("HAMMER")]
    wide = hammer.pivot(index=["dataset", "method"], columns="metric", values="value")
    assert (wide["rmse"] >= wide["mae"]).all()
    assert (wide["d125"] >= wide["d1118"]).all()


def test_no_table_has_two_protocols() -> None:
    rows = load.published_rows()
    tables = published_tables(EVERY)
    assert sum(len(t.rows) for t in tables) > 100
    assert not any("specular_transparent" in c.heading for t in tables for c in t.columns)
    places = rows[rows["task"] != "speed"][["task", "dataset", "protocol"]].drop_duplicates()
    others = [t for t in tables if "frames/s" not in t.columns[-1].title]
    assert len(others) == len(places)
    transcg = [t for t in tables if t.title.startswith("TransCG test")]
    assert [t.title.split(", ")[1] for t in transcg] == [
        "protocol transcg",
        "protocol transcg-2022-10",
    ]
    assert [row.cells[0].text for row in transcg[1].rows] == ["DFNet (checkpoint 2022-10)"]
    (clearpose,) = [t for t in tables if t.title.startswith("ClearPose")]
    assert "aligned-clip" in clearpose.title and "140.2" in clearpose.terminal()
    assert "paper text" in clearpose.terminal() and "arxiv.org/abs/2512.23705" in clearpose.notes[1]


def test_published_rows_stand_only_under_their_protocol(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=2, frames=2)
    runs = [
        a_run(root, tmp_path / "r", "nearest", gallery=False, protocol=protocol)
        for protocol in ("strict", "paper")
    ]
    with published_as(4, 2):
        run_all(runs, JobOptions(engine="serial", progress=False))
    board = make_board(read_results([tmp_path / "r"]), samples=20)
    printed = board.rows[board.rows["kind"] == PUBLISHED]
    assert set(printed["protocol"]) == {"paper"} and set(printed["trust"]) == {"paper text"}
    (part,) = make_parts([tmp_path / "r"])
    (section,) = [s for s in part.sections if s.anchor == "published"]
    titles = [block.title for block in section.blocks]
    assert titles == ["STD-CatKnown, protocol aligned-clip, full frame"]
    page = render_page([part])
    assert "Diffusion Knows Transparency" in page and "Camera Depth Models" not in page
    (bare,) = make_parts([tmp_path / "r"], published=False)
    assert "published" not in [s.anchor for s in bare.sections]


def test_published_rows_stand_beside_a_run_under_an_aligned_protocol(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=2, frames=2)
    run = a_run(root, tmp_path / "r", "nearest", gallery=False, protocol="aligned-clip")
    with published_as(4, 2):
        run_all([run], JobOptions(engine="serial", progress=False))
    board = make_board(read_results([tmp_path / "r"]), samples=20)
    printed = board.rows[board.rows["kind"] == PUBLISHED].set_index("method")
    assert set(printed["protocol"]) == {"aligned-clip"} and set(printed["subset"]) == {"scene"}
    assert printed.loc["DKT", "rmse"] == pytest.approx(0.0496)
    (part,) = make_parts([tmp_path / "r"])
    tables = [b.title for s in part.sections if s.anchor == "published" for b in s.blocks]
    assert tables and not any("aligned-clip" in title for title in tables)
    page = render_page([part])
    assert "DKT" in page and "MoGe" in page


def test_the_command_lists_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "published"]) == 0
    text = capsys.readouterr().out
    assert "HAMMER D435, protocol full-frame, full frame" in text
    assert "pypi.org/project/rgbd-depth" in text and "D3RoMa" not in text
    assert main(["list", "published", "--task", "grasp", "--json"]) == 0
    records = json.loads(capsys.readouterr().out)
    assert {record["trust"] for record in records} == {"paper text"}
    assert np.isclose([r["value"] for r in records if r["metric"] == "success_rate"], 0.384).any()
