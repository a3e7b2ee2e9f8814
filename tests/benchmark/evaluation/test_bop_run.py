"""Result files of BOP through the run engine: workers, resume, damaged images, intervals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.known_data import CONTENT_FILE, DATA_FILE
from benchmark.evaluation.manifest import BOP_FILE, BOP_MANIFEST
from benchmark.evaluation.results import FAILURES, PARTS
from benchmark.evaluation.tasks.bop import BopRun
from benchmark.evaluation.tasks.bop_results import (
    ERRORS,
    SCORES_19,
    SCORES_24,
    bop_intervals,
    read_bop_run,
)
from benchmark.metrics.bop import (
    BopEstimate,
    open_bop,
    read_bop_results,
    score_bop,
    score_bop_detection,
    write_bop_results,
)
from benchmark.report.page import make_parts
from std_toolkit.geometry import SE3
from std_toolkit.jobs import JobOptions
from tests.benchmark.metrics.bop.bop_set import TRUTHS, write_bop

SERIAL = JobOptions(engine="serial", progress=False)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bop(tmp_path_factory.mktemp("data") / "set")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Estimates that are each a little off."""
    path = tmp_path_factory.mktemp("results") / "mine_set-test.csv"
    estimates = [
        BopEstimate(
            2, image, number, 1 - 0.1 * k, SE3(T.R, T.t + np.array([0.004, 0, 0.011 * image])), 0.5
        )
        for image, truths in TRUTHS.items()
        for k, (number, T) in enumerate(truths)
    ]
    write_bop_results(path, estimates)
    return path


def run_of(root: Path, results: Path, out: Path) -> BopRun:
    return BopRun(data=root, split="test", results=results, out=out)


def bytes_of(run: BopRun) -> tuple[bytes, bytes]:
    return (run.folder / ERRORS).read_bytes(), (run.folder / BOP_FILE).read_bytes()


@pytest.mark.slow
def test_figures_are_those_of_the_metric(root: Path, results: Path, tmp_path: Path) -> None:
    run = run_of(root, results, tmp_path)
    assert not run_all([run], SERIAL).failed
    scores = score_bop(open_bop(root), read_bop_results(results))
    detected = score_bop_detection(open_bop(root), read_bop_results(results))
    kept = json.loads((run.folder / BOP_FILE).read_text())
    assert 0 < scores.ar < 1 and 0 < detected.map < 1
    names = {
        "bop19_average_recall": scores.ar, "bop19_average_recall_vsd": scores.vsd,
        "bop19_average_recall_mssd": scores.mssd, "bop19_average_recall_mspd": scores.mspd,
        "bop19_average_time_per_image": 0.5, "bop24_average_time_per_image": 0.5,
        "bop24_mAP": detected.map, "bop24_mAP_mssd": detected.mssd,
        "bop24_mAP_mspd": detected.mspd, "bop24_mAP_mssd_mm": detected.mssd_mm,
        "bop25_mAP": detected.mssd, "bop25_mAP_mm": detected.mssd_mm,
    }  # fmt: skip
    assert kept.pop("scores") == names
    objects = {o["obj_id"]: o for o in kept.pop("objects")}
    assert [objects[k]["targets"] for k in (1, 5)] == [2, 1]
    weighted = sum(o["targets"] * o["ar_mssd"] for o in objects.values()) / 3
    assert weighted == pytest.approx(scores.mssd)
    assert np.mean([o["ap_mspd"] for o in objects.values()]) == pytest.approx(detected.mspd)
    assert kept == {
        "results": "mine_set-test", "data": str(root), "split": "test", "targets": 3,
        "estimates": 4, "ar": scores.ar, "ar_vsd": scores.vsd, "ar_mssd": scores.mssd,
        "ar_mspd": scores.mspd, "ap": detected.map, "ap_mssd": detected.mssd,
        "ap_mspd": detected.mspd, "ap_mssd_mm": detected.mssd_mm, "seconds_per_image": 0.5,
    }  # fmt: skip
    written = [json.loads((run.folder / f"scores_bop{y}.json").read_text()) for y in (19, 24)]
    assert written[0] | written[1] == names
    table = pd.read_parquet(run.folder / ERRORS)
    assert table[["index", "scene", "frame", "obj_id", "n_valid"]].to_numpy().tolist() == [
        [0, "000002", "000003", 1, 1],
        [0, "000002", "000003", 5, 1],
        [1, "000002", "000004", 1, 1],
    ]


@pytest.mark.slow
def test_serial_parallel_and_killed_runs_give_the_same_bytes(
    root: Path, results: Path, tmp_path: Path
) -> None:
    runs = [run_of(root, results, tmp_path / name) for name in ("serial", "parallel", "killed")]
    assert not run_all(runs[:1], SERIAL).failed
    assert not run_all(runs[1:2], JobOptions(workers=2, progress=False)).failed
    program = (
        "import time; from pathlib import Path\n"
        "from benchmark.evaluation import engine\n"
        "from benchmark.evaluation.tasks.bop import BopRun\n"
        "from std_toolkit.jobs import JobOptions\n"
        "rows = BopRun.rows\n"
        "BopRun.rows = lambda *a: (a[3][0][0]['index'] and time.sleep(60), rows(*a))[1]\n"
        f"run = BopRun(data=Path({str(root)!r}), split='test', results=Path({str(results)!r}),\n"
        f"    out=Path({str(tmp_path / 'killed')!r}))\n"
        "engine.run_all([run], JobOptions(engine='serial', progress=False))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program])
    parts = runs[2].folder / "parts"
    while not list(parts.glob("0*.parquet")):
        assert process.poll() is None, "it ended before it could be killed"
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert [p.name for p in parts.glob("0*.parquet")] == ["0000000-0000000.parquet"]
    assert not (runs[2].folder / BOP_FILE).exists()
    assert not run_all(runs[2:], SERIAL).failed
    assert bytes_of(runs[0]) == bytes_of(runs[1]) == bytes_of(runs[2])


def test_missing_depth_stops_only_vsd(results: Path, tmp_path: Path) -> None:
    root = write_bop(tmp_path / "set")
    depth = root / "test" / "000002" / "depth" / "000004.png"
    content = depth.read_bytes()
    depth.unlink()
    run, whole = run_of(root, results, tmp_path / "out"), run_of(root, results, tmp_path / "whole")
    report = run_all([run], SERIAL)
    # It is listed, and the exit status will be 1; everything else is scored.
    assert report.failed_frames == 1 and report.finished and not report.failed
    found = run.read()
    assert found.ar is None and found.ar_vsd is None and "ar_vsd" not in found.intervals
    assert pd.read_csv(run.folder / FAILURES, dtype=str)["frame"].tolist() == ["000004"]
    depth.write_bytes(content)
    assert not run_all([run], SERIAL).failed_frames
    run_all([whole], SERIAL)
    assert bytes_of(run) == bytes_of(whole)
    for name in ("ar_mssd", "ar_mspd", "ap_mssd", "ap_mspd"):
        assert getattr(found, name) == getattr(whole.read(), name) is not None


def test_data_without_depth(
    results: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    root = write_bop(tmp_path / "set")
    folder = root / "test" / "000002"
    (folder / "depth").rename(folder / "rgb")  # the size of the images is still needed
    run = run_of(root, results, tmp_path / "out")
    assert not run_all([run], SERIAL).failed_frames
    assert [r.message for r in caplog.records if "VSD is not scored" in r.message] != []
    found = run.read()
    assert found.ar is None and 0 < (found.ar_mssd or 0) < 1
    scores = json.loads((run.folder / "scores_bop19.json").read_text())
    assert set(scores) == {
        "bop19_average_recall_mssd", "bop19_average_recall_mspd", "bop19_average_time_per_image"
    }  # fmt: skip
    only = BopRun(data=root, split="test", results=results, out=tmp_path / "one", errors=("mspd",))
    assert not run_all([only], SERIAL).failed
    assert only.read().ar_mspd == found.ar_mspd and only.read().ap_mssd is None


def test_no_figures_with_an_image_left_out(results: Path, tmp_path: Path) -> None:
    root = write_bop(tmp_path / "set")
    depth = root / "test" / "000002" / "depth" / "000004.png"
    content = depth.read_bytes()
    depth.write_bytes(b"no picture")  # and no other one tells the size
    run = run_of(root, results, tmp_path / "out")
    report = run_all([run], SERIAL)
    assert report.failed_frames == 1 and not report.finished
    assert "depth/000004.png" in report.failed[run.title]
    assert not (run.folder / BOP_FILE).exists()
    assert pd.read_csv(run.folder / FAILURES, dtype=str)["frame"].tolist() == ["000004"]
    depth.write_bytes(content)
    assert not run_all([run], SERIAL).failed
    whole = run_of(root, results, tmp_path / "whole")
    run_all([whole], SERIAL)
    assert bytes_of(run) == bytes_of(whole)


def test_a_folder_of_an_older_version_goes_on(root: Path, results: Path, tmp_path: Path) -> None:
    run = run_of(root, results, tmp_path)
    assert not run_all([run], SERIAL).failed
    figures = (run.folder / BOP_FILE).read_bytes()
    for name in (BOP_MANIFEST, ERRORS, FAILURES, SCORES_19, SCORES_24, DATA_FILE, CONTENT_FILE):
        (run.folder / name).unlink()
    (run.folder / PARTS).rmdir()
    old = read_bop_run(run.folder)
    assert old.ar > 0 and old.intervals == {}
    assert not run_all([run], SERIAL).failed
    assert (run.folder / BOP_FILE).read_bytes() == figures


def test_another_file_of_this_name_does_not_mix(root: Path, results: Path, tmp_path: Path) -> None:
    run = run_of(root, results, tmp_path / "out")
    assert not run_all([run], SERIAL).failed
    other = tmp_path / results.name
    write_bop_results(other, read_bop_results(results)[:1])
    failed = run_all([run_of(root, other, tmp_path / "out")], SERIAL).failed
    assert "results_sha256" in failed[run.title]


def test_intervals_draw_scenes_or_images(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [BopEstimate(2, 3, number, 1.0, T) for number, T in TRUTHS[3][:2]]
    write_bop_results(tmp_path / "half_set-test.csv", found)
    words = ["bop", "--data", str(root), "--results", str(tmp_path / "half_set-test.csv")]
    words += ["--engine", "serial", "--out", str(tmp_path / "out")]
    assert main([*words, "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    # One scene of two images: all found in one, with two targets, and nothing in the other.
    assert row["ar"] == pytest.approx(2 / 3)
    assert row["intervals_over"] == "images"
    assert {k: v for k, v in row["intervals"].items() if k.startswith("ar")} == {
        k: [0, 1] for k in ("ar", "ar_vsd", "ar_mssd", "ar_mspd")
    }
    # Both cans, or one and then nothing; the brick is in one image alone.
    assert row["intervals"]["ap"] == [0, 1]
    (part,) = make_parts([tmp_path / "out"])
    text = part.sections[0].blocks[0].markdown()
    assert "66.7 [0.0, 100.0]" in text and "95 % intervals over images" in text
    table = pd.DataFrame(
        {
            "index": [0, 1, 2], "scene": ["a", "a", "b"], "n_valid": [1, 2, 1],
            "found_vsd": [1.0, 1.0, 0.0], "found_mssd": [1.0, 2.0, 0.0],
            "found_mspd": [0.0, 0.0, 0.0],
        }
    )  # fmt: skip
    intervals, over = bop_intervals(table)
    assert over == "scenes"
    assert intervals["ar_vsd"] == pytest.approx((0, 2 / 3))
    assert intervals["ar_mssd"] == (0, 1) and intervals["ar_mspd"] == (0, 0)
    assert bop_intervals(table[:1]) == ({}, "")
