"""`std-bench verify`: which figures of results hold, and what is found where they do not."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli import report as report_cli
from benchmark.cli.bench import main
from benchmark.data.known_splits import STD_CATKNOWN
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.query_options import VerifyOptions
from benchmark.evaluation.results import TABLE
from benchmark.evaluation.verification import VERIFICATION, VerifiedRun, read_grades
from benchmark.evaluation.verify import verify
from benchmark.metrics.bop import BopEstimate, write_bop_results
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import write_document
from std_toolkit.io.exr import read_exr, write_exr
from std_toolkit.io.images import write_png
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import SPLIT, a_run, write_split
from tests.benchmark.evaluation.pose_set import a_pose_run, write_pose_split
from tests.benchmark.metrics.bop.bop_set import TRUTHS, write_bop

JOBS = JobOptions(engine="serial", progress=False)
METHODS = "tests/benchmark/evaluation/bench_set.py"


def ask(out: Path, **options: object) -> VerifyOptions:
    return VerifyOptions(results=(out,), jobs=JOBS, **options)  # type: ignore[arg-type]


def of(runs: list[VerifiedRun], label: str) -> VerifiedRun:
    return next(run for run in runs if label in run.title)


def state(run: VerifiedRun, name: str) -> str:
    return [c.state for c in run.checks if c.name == name][-1]


def about(run: VerifiedRun, name: str) -> str:
    return [c.about for c in run.checks if c.name == name][-1]


@pytest.fixture
def scored(tmp_path: Path) -> tuple[Path, Path]:
    """Data, and results of raw depth and of a method whose depth is kept."""
    root = write_split(tmp_path / "data", scenes=2, frames=3)
    out = tmp_path / "r"
    runs = [
        a_run(root, out, "raw", gallery=False),
        a_run(root, out, "nearest", gallery=False, save_depth=True),
    ]
    assert not run_all(runs, JOBS).failed
    return root, out


def test_saved_depth_gives_the_figures_to_the_last_bit(scored: tuple[Path, Path]) -> None:
    root, out = scored
    runs = verify(ask(out, data=(str(root),))).runs
    nearest = of(runs, "nearest")
    assert nearest.holds and nearest.grade == "recomputed" and nearest.frames == nearest.of == 6
    assert "equal to the last bit" in about(nearest, "rows")
    assert state(nearest, "data") == "holds" and "digests of the run" in about(nearest, "data")
    assert {f.figure for f in nearest.figures} >= {"RMSE [mm]", "answered [%]"}
    assert of(runs, "raw").grade == "rerun"


def test_without_data_only_the_files_are_checked(scored: tuple[Path, Path]) -> None:
    _, out = scored
    runs = verify(ask(out)).runs
    assert all(run.holds and run.grade == "reported" and not run.figures for run in runs)
    assert {c.name for c in runs[0].checks} == {"frames", "names", "data.json"}
    with pytest.raises(ToolkitError, match="needs the data"):
        ask(out, sample=3)


def test_a_run_without_any_answer_is_told(scored: tuple[Path, Path]) -> None:
    root, out = scored
    run = a_run(root, out, f"{METHODS}:Failing", gallery=False)
    run_all([run], JOBS)
    assert about(of(verify(ask(out)).runs, "Failing"), "frames").startswith("no frame was answered")


def test_a_row_that_was_improved_is_found(scored: tuple[Path, Path]) -> None:
    root, out = scored
    path = out / SPLIT / "nearest" / "strict" / TABLE
    table = pd.read_parquet(path)
    table.loc[(table["frame"] == "0001") & (table["subset"] == "all"), "rmse"] *= 0.5
    table.to_parquet(path)
    run = of(verify(ask(out, data=(str(root),))).runs, "nearest")
    assert not run.holds and run.grade == "reported"
    assert "rmse of test_0/0001/h126w224/all" in about(run, "rows")
    wrong = [(f.subset, f.figure) for f in run.figures if not f.holds]
    assert wrong == [("all", "RMSE [mm]")]


def test_a_prediction_that_was_changed_is_found(scored: tuple[Path, Path]) -> None:
    root, out = scored
    path = next((out / SPLIT / "nearest" / "strict" / "depth").rglob("0002_*.exr"))
    depth = read_exr(path)["R"].copy()
    depth += np.float32(0.01)
    write_exr(path, dict.fromkeys("RGB", depth))
    run = of(verify(ask(out, data=(str(root),))).runs, "nearest")
    assert state(run, "rows") == "fails" and "reported" in about(run, "rows")


def test_a_sample_is_stated(scored: tuple[Path, Path]) -> None:
    root, out = scored
    run = of(verify(ask(out, data=(str(root),), sample=2)).runs, "nearest")
    assert run.holds and run.graded == "recomputed (2 of 6 frames)"


def test_changed_truth_is_named(scored: tuple[Path, Path]) -> None:
    root, out = scored
    path = root / "STD-CatKnown" / "test_1" / "0000_gt_depth.exr"
    depth = read_exr(path)["R"].copy()
    depth[depth > 0] += np.float32(0.02)
    write_exr(path, dict.fromkeys("RGB", depth))
    run = of(verify(ask(out, data=(str(root),))).runs, "nearest")
    assert state(run, "data") == "fails"
    assert "ground-truth depth of test_1/0000" in about(run, "data")


def test_missing_frames_and_rows(scored: tuple[Path, Path]) -> None:
    root, out = scored
    path = out / SPLIT / "nearest" / "strict" / TABLE
    table = pd.read_parquet(path)
    table[table["frame"] != "0001"].to_parquet(path)
    run = of(verify(ask(out)).runs, "nearest")
    assert state(run, "frames") == "fails" and about(run, "frames") == "4 of 6 have rows"
    assert state(run, "names") == "fails"
    for file in (root / "STD-CatKnown" / "test_1").glob("0000*"):
        file.unlink()
    run = of(verify(ask(out, data=(str(root),))).runs, "raw")
    assert "1 of 6 frames of the run are not below this folder" in about(run, "rows")


def test_an_edited_leaderboard_is_found(scored: tuple[Path, Path]) -> None:
    _, out = scored
    assert report_cli.main([str(out)]) == 0
    assert all(state(run, "leaderboard.csv") == "holds" for run in verify(ask(out)).runs)
    table = pd.read_csv(out / "leaderboard.csv")
    place = table.index[(table["method"] == "nearest") & (table["subset"] == "transparent")][0]
    table.loc[place, "mae"] *= 0.99
    table.to_csv(out / "leaderboard.csv", index=False)
    run = of(verify(ask(out)).runs, "nearest")
    assert state(run, "leaderboard.csv") == "fails"
    assert about(run, "leaderboard.csv") == "differs: mae of transparent"


def test_a_folder_of_another_program(tmp_path: Path) -> None:
    """Its predictions are known by digest, and may have moved."""
    root = write_split(tmp_path / "data", scenes=1, frames=2)
    source = STD_CATKNOWN.open(root)
    for i, key in enumerate(source.keys()):
        true = source.load(i).depth_true
        there = np.where(true > 0, true + 0.004, 0.7)
        (tmp_path / "mine" / key.scene).mkdir(parents=True, exist_ok=True)
        path = tmp_path / "mine" / key.scene / f"{key.name}.png"
        write_png(path, (there * 1000).round().astype(np.uint16))
    out, data = tmp_path / "r", ("--data", str(root))
    words = ["--method", f"mine={tmp_path / 'mine'}", "--split", SPLIT, "--out", str(out)]
    assert main([*words, *data, "--engine", "serial", "--no-gallery"]) == 0
    again = [str(out), *data, "--engine", "serial"]
    assert main(["verify", *again]) == 0
    (tmp_path / "mine").rename(tmp_path / "moved")
    run = verify(ask(out, data=(str(root),))).runs[0]
    assert run.holds and state(run, "rows") == "not checked" and run.grade == "reported"
    moved = ["--predictions", f"mine={tmp_path / 'moved'}"]
    assert main(["verify", *again, *moved]) == 0
    record = json.loads((out / VERIFICATION).read_text())["runs"][0]
    assert record["grade"] == "recomputed"
    assert {c["name"]: c["state"] for c in record["checks"]}["predictions"] == "holds"
    # Its program cannot be run here: a rerun of `raw` on its files is none.
    assert main(["verify", *again, *moved, "--rerun"]) == 0
    assert json.loads((out / VERIFICATION).read_text())["runs"][0]["grade"] == "recomputed"
    path = tmp_path / "moved" / path.relative_to(tmp_path / "mine")
    write_png(path, np.full(there.shape, 650, np.uint16))
    assert main(["verify", *again, *moved]) == 1
    assert read_grades([out / VERIFICATION]) == {}


def test_a_grade_is_lost_with_the_first_change(scored: tuple[Path, Path]) -> None:
    root, out = scored
    done = verify(ask(out, data=(str(root),)))
    write_document(out / VERIFICATION, done)
    run = of(done.runs, "nearest")
    assert read_grades([out / VERIFICATION])[run.digest].grade == "recomputed"
    path = out / SPLIT / "nearest" / "strict" / TABLE
    table = pd.read_parquet(path)
    table["mae"] *= 1 - 1e-12
    table.to_parquet(path)
    assert of(verify(ask(out)).runs, "nearest").digest not in read_grades([out / VERIFICATION])


def test_a_method_is_run_again_only_if_it_is_trusted(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=1, frames=2)
    name = f"{METHODS}:Filling"
    evaluate(name, SPLIT, data=root, out=tmp_path / "r", jobs=JOBS)
    options = {"data": (str(root),), "rerun": True}
    run = verify(ask(tmp_path / "r", **options)).runs[0]
    assert run.grade == "reported" and "code of somebody else" in about(run, "rows")
    run = verify(ask(tmp_path / "r", **options, trust=(name,))).runs[0]
    assert run.holds and run.grade == "rerun" and state(run, "settings") == "holds"


def test_true_poses_of_a_table(tmp_path: Path) -> None:
    root = write_pose_split(tmp_path / "data", scenes=1, frames=2)
    assert not run_all([a_pose_run(root, tmp_path / "r", gallery=False)], JOBS).failed
    run = verify(ask(tmp_path / "r", data=(str(root),))).runs[0]
    assert run.holds and run.grade == "recomputed" and len(run.figures) > 4
    path = next((tmp_path / "r").rglob("poses.parquet"))
    table = pd.read_parquet(path)
    first = table.index[table["kind"] == "true"][0]
    table.loc[first, "rt03"] += 0.03
    table.to_parquet(path)
    run = verify(ask(tmp_path / "r", data=(str(root),))).runs[0]
    assert state(run, "rows") == "fails" and "rt03" in about(run, "rows")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: s | {"split": "os:SPLIT"}, "no split of this toolkit"),
        (lambda s: s | {"protocol": "os:PROTOCOL"}, "no protocol of this toolkit"),
    ],
)
def test_nothing_that_results_name_is_imported(
    scored: tuple[Path, Path], change: Callable[[dict[str, str]], dict[str, str]], said: str
) -> None:
    root, out = scored
    path = out / SPLIT / "nearest" / "strict" / "run.json"
    manifest = json.loads(path.read_text())
    manifest["setup"] = change(manifest["setup"])
    path.write_text(json.dumps(manifest))
    run = of(verify(ask(out, data=(str(root),))).runs, "nearest")
    assert said in about(run, "rows") and run.grade == "reported"


def test_a_file_of_bop(tmp_path: Path) -> None:
    """Figures follow from the table of errors, and that from the file, known by its digest."""
    root = write_bop(tmp_path / "set")
    file = tmp_path / "mine_set-test.csv"
    estimates = [
        BopEstimate(2, image, number, 1.0, SE3(T.R, T.t + np.array([0.004, 0, 0])), 0.5)
        for image, truths in TRUTHS.items()
        for number, T in truths
    ]
    write_bop_results(file, estimates)
    words = ["bop", "--data", str(root), "--results", str(file), "--out", str(tmp_path / "r")]
    assert main([*words, "--engine", "serial"]) == 0
    options = {"data": (str(root),), "predictions": (f"{file.stem}={file}",)}
    run = verify(ask(tmp_path / "r", **options)).runs[0]
    assert run.holds and run.grade == "recomputed"
    recalls, precisions = ["ar", "ar_vsd", "ar_mssd", "ar_mspd"], ["ap", "ap_mssd", "ap_mspd"]
    assert [f.figure for f in run.figures] == [*recalls, *precisions, "ap_mssd_mm"]
    assert "--predictions" in about(verify(ask(tmp_path / "r", data=(str(root),))).runs[0], "rows")
    path = next((tmp_path / "r").rglob("bop.json"))
    figures = json.loads(path.read_text())
    path.write_text(json.dumps(figures | {"ar": 0.999}))
    run = verify(ask(tmp_path / "r", **options)).runs[0]
    assert state(run, "bop.json") == "fails"
    assert [f.figure for f in run.figures if not f.holds] == ["ar"]
    file.write_text(file.read_text().replace("0.5\n", "0.6\n"))
    assert "SHA-256 differs" in about(verify(ask(tmp_path / "r", **options)).runs[0], "rows")
