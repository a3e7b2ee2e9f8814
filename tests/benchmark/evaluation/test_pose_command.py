"""`std-bench pose` and `std-bench bop` from the command line, and their report."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.cli.report import PAGE
from benchmark.cli.report import main as report
from benchmark.evaluation.config import PoseConfig
from benchmark.evaluation.tasks.pose import plan_runs
from benchmark.evaluation.tasks.pose_results import read_pose_results, score_run, wanted_protocols
from benchmark.methods.protocol import Estimated
from benchmark.metrics.bop import BopEstimate, open_bop, write_bop_results
from benchmark.metrics.pose import PosePrediction
from benchmark.published.load import published_poses
from benchmark.report.page import make_parts
from benchmark.report.parts.pose import CSV, LATEX, MARKDOWN, findings
from benchmark.report.parts.pose_board import compare_runs, make_pose_board
from std_toolkit.errors import ToolkitError
from tests.benchmark.evaluation.bench_set import published_as
from tests.benchmark.evaluation.pose_set import SPLIT, write_pose_split
from tests.benchmark.metrics.bop.bop_set import TRUTHS, write_bop


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pose_split(tmp_path_factory.mktemp("data"), scenes=7, frames=1)


@pytest.fixture(scope="module")
def results(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    # Nothing was saved there: every frame fails, and counts as missed.
    with published_as(7, 7, SPLIT):
        assert bench(root, out, "--method", "gt-nocs", "--depth", "raw", "gt", f"mine={root}") == 1
    return out


def bench(root: Path, out: Path, *more: str) -> int:
    words = ["pose", "--data", str(root), "--split", SPLIT, "--out", str(out)]
    return main([*words, "--engine", "serial", *more])


def test_tables_in_the_terminal(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--method", "gt-nocs", "--depth", "raw", "gt", "--limit", "2", "--no-gallery")
    assert bench(root, tmp_path, *words, "--protocol", "strict", "paper", "--score", "ap") == 0
    text = capsys.readouterr().out
    assert f"{SPLIT}, protocol strict, poses right in %" in text
    assert f"{SPLIT}, protocol paper, score ap" in text
    assert re.search(r"gt-nocs +gt +ransac +all +6( +100\.0){8}", text)
    assert re.search(r"gt-nocs +raw +ransac +specular\+transparent +4 ", text)


@pytest.mark.slow
def test_pages_and_tables(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report([str(results)]) == 0
    page = (results / PAGE).read_text()
    for wanted in ("Does restoring depth help", "SwinDRNet+NOCSHead", "true box", "What ran"):
        assert wanted in page
    assert page.count("data:image/webp") == 3 * 6, "six frames of each of three runs"
    assert "no such file" not in page
    table = pd.read_csv(results / CSV)
    mine = table[(table["kind"] == "measured") & (table["protocol"] == "strict")]
    right = mine[(mine["depth"] == "gt") & (mine["subset"] == "all")]
    assert right["5deg2cm"].tolist() == [1.0]
    printed = table[table["kind"] == "published"]
    row = printed[printed["method"] == "SGPA, raw depth"].iloc[0]
    assert row["iou75"] == pytest.approx(0.30)
    assert r"\begin{tabular}" in (results / LATEX).read_text()
    assert "*SGPA, raw depth*" in (results / MARKDOWN).read_text()
    assert "gt-nocs" in capsys.readouterr().out
    before = page
    assert report([str(results)]) == 0
    assert (results / PAGE).read_text() == before, "the same results give the same bytes"


@pytest.mark.slow
def test_depth_and_poses_on_one_page(root: Path, tmp_path: Path) -> None:
    words = ["--data", str(root), "--split", SPLIT, "--out", str(tmp_path), "--engine", "serial"]
    words += ["--limit", "2", "--no-gallery"]
    assert main([*words, "--method", "raw", "--no-speed"]) == 0
    assert main(["pose", *words, "--method", "gt-nocs"]) == 0
    assert report([str(tmp_path), "--no-published"]) == 0
    page = (tmp_path / PAGE).read_text()
    assert "<h1>Depth restoration, category-level pose</h1>" in page
    assert "Lowest RMSE" in page and "methods that receive ground truth" in page
    assert "SwinDRNet" not in page
    assert (tmp_path / CSV).exists() and (tmp_path / "leaderboard.csv").exists()


def test_true_depth_helps_and_the_test_says_so(results: Path) -> None:
    runs = {r.name[1]: r for r in read_pose_results([results]) if r.name[1] in ("raw", "gt")}
    strict = wanted_protocols(["strict"])[0]
    scored = {name: score_run(r, strict, samples=50) for name, r in runs.items()}
    gain, low, high, p = compare_runs(scored["gt"], scored["raw"], samples=200).of("5deg5cm")
    expected = scored["gt"].scores.mean["5deg5cm"] - scored["raw"].scores.mean["5deg5cm"]
    assert gain == pytest.approx(expected)
    assert 0.2 < low <= gain <= high
    assert p == pytest.approx(2 / 2**7), "all seven scenes gain"
    same = compare_runs(scored["gt"], scored["gt"], samples=50)
    assert (same.difference == 0).all() and (same.p == 1).all()
    board = make_pose_board(read_pose_results([results]), samples=20)
    (mine,) = findings(board, "all")
    assert (mine.depth, mine.verdict, mine.after) == ("mine", "hurts", 0.0)


def test_what_the_paper_prints_of_poses() -> None:
    rows = published_poses()
    ours = rows[(rows["method"] == "SwinDRNet+NOCSHead, restored depth")]
    assert ours["split"].tolist() == [SPLIT, "std-catknown"]
    assert ours["10deg5cm"].tolist() == [0.728, 0.797]
    assert np.isfinite(rows["iou25"]).all()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--method", "nocz"], "nocz"),
        (["--method", "gt-nocs", "--protocol", "strikt"], "strikt"),
        (["--method", "gt-nocs", "--depth", "swinnet"], "swinnet"),
        (["--method", "gt-nocs", "--depth", "raw=/x"], "name of its own"),
        (["--method", "gt-nocs", "--depth", "swindrnet", "--weights", "/x"], "which method"),
    ],
)
def test_one_line_for_what_is_wrong(
    root: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    told: str,
) -> None:
    assert bench(root, tmp_path, *arguments) == 1
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1, errors
    assert re.search(told, errors[0])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--method", "gt-nocs", "--depth", "raw", "raw"], "--depth: is given twice"),
        (["--method", "gt-nocs", "--save-depth"], "--save-depth: not an option of std-bench pose"),
        (["--method", "gt-nocs", "--fit", "p3p"], "--fit: p3p: expected one of ransac, paper"),
        ([], "--method: needed"),
    ],
)
def test_wrong_usage_has_a_status_of_its_own(
    root: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    told: str,
) -> None:
    assert bench(root, tmp_path, *arguments) == 2
    assert told in capsys.readouterr().err


def test_figures_as_json(results: Path, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench(root, results, "--method", "gt-nocs", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["split"] for row in rows} == {SPLIT}
    assert all(0 <= row["iou25"] <= 1 and row["true"] > 0 for row in rows)


@pytest.mark.slow
def test_what_pose_methods_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "methods", "--task", "pose"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"^gt-nocs +True masks", text, re.M)


@pytest.mark.slow
def test_result_files_of_bop(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = write_bop(tmp_path / "set")
    dataset = open_bop(root)
    estimates = [
        BopEstimate(t.scene_id, t.im_id, t.obj_id, 1.0, pose)
        for t in dataset.targets
        for pose in dataset.truths(t.scene_id, t.im_id, t.obj_id)[0]
    ]
    write_bop_results(tmp_path / "mine_set-test.csv", estimates)
    words = ["bop", "--data", str(root), "--out", str(tmp_path / "out")]
    words += ["--results", str(tmp_path / "mine_set-test.csv")]
    assert main(words) == 0
    assert re.search(r"mine_set-test +set, test +\d+( +100\.0){4}", capsys.readouterr().out)
    assert report([str(tmp_path / "out")]) == 0
    assert "AR is the mean of the average recalls" in (tmp_path / "out" / PAGE).read_text()
    capsys.readouterr()
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["ar"] == 1
    assert main(words[:3]) == 2
    assert "--results: needs" in capsys.readouterr().err


def test_raw_depth_is_raw_depth_also_as_input(tmp_path: Path) -> None:
    config = PoseConfig(
        methods=("nocs",),
        splits=(SPLIT,),
        depths=("raw", "swindrnet", "mine=/saved"),
        fits=("ransac", "paper"),
        depth_as_input=True,
        data=(f"{SPLIT}=/data",),
        out=tmp_path,
        weights=("nocs=/n", "swindrnet=/s"),
        settings=("swindrnet.fusion=released", "nocs.most=5"),
    )
    runs = plan_runs(config)
    assert [r.folder.relative_to(tmp_path / "pose" / SPLIT).as_posix() for r in runs] == [
        f"nocs/{depth}/{fit}"
        for depth in ("raw", "swindrnet-as-input", "mine-as-input")
        for fit in ("ransac", "paper")
    ]
    restored = runs[2]
    assert restored.options.weights == Path("/n")
    assert restored.settings == {"most": "5", "fit": "ransac"}
    assert restored.depth.options.weights == Path("/s")
    assert restored.depth.options.settings == {"fusion": "released"}
    assert runs[4].depth.folder == Path("/saved")


def test_protocols_say_what_was_changed() -> None:
    (one,) = wanted_protocols(["paper"], iou="oriented", score="ap", gates="all")
    assert one.name == "paper, iou oriented, score ap, gates all"
    assert one.pose_needs_iou is None
    assert wanted_protocols(["strict"], iou="oriented", gates="all")[0].name == "strict"
    with pytest.raises(ToolkitError):
        wanted_protocols(["papers"])


def test_what_receives_the_truth_is_no_headline(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`gt-nocs` is far better than a method that sees a bottle everywhere, and is a bound."""
    finding = "tests.benchmark.evaluation.pose_set:Finding"
    words = ("--method", "gt-nocs", finding, "--depth", "raw", "--limit", "2", "--no-gallery")
    assert bench(root, tmp_path, *words) == 0
    manifests = [json.loads(p.read_text()) for p in tmp_path.rglob("pose.json")]
    assert sorted(m["setup"]["given_truth"] for m in manifests) == [False, True]
    board = make_pose_board(read_pose_results([tmp_path]), published=False, samples=10)
    rows = board.part(SPLIT, "strict", "all")
    contests = dict(zip(rows["method"], board.contests(rows), strict=True))
    assert not contests["gt-nocs"] and sum(contests.values()) == 1
    (part,) = make_parts([tmp_path], published=False)
    assert "gt-nocs" not in part.summary and "Finding" in part.summary


def test_masks_may_be_a_list() -> None:
    one = PosePrediction([1, 2], np.tile(np.eye(4), (2, 1, 1)), np.full((2, 3), 0.5), [1.0, 0.5])
    masks = [np.zeros((4, 6), bool), np.ones((4, 6), np.uint8)]
    found = Estimated(one, masks)
    assert found.masks.shape == (2, 4, 6) and found.masks.dtype == bool and found.masks[1].all()
    none = PosePrediction([], [], [], [])
    assert Estimated(none, []).masks is None
    for wrong in (masks[:1], [masks[0], np.zeros((4, 5), bool)], [np.zeros(4, bool)] * 2):
        with pytest.raises(ToolkitError, match="masks"):
            Estimated(one, wrong)


def test_published_figures_of_bop(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Beside results on a data set of that name, with their source."""
    root = write_bop(tmp_path / "lmo")
    results = tmp_path / "mine_lmo-test.csv"
    write_bop_results(results, [BopEstimate(2, 4, *TRUTHS[4][0][:1], 0.5, TRUTHS[4][0][1])])
    words = ["bop", "--data", str(root), "--results", str(results), "--out", str(tmp_path / "out")]
    assert main([*words, "--engine", "serial", "--errors", "mssd", "--symmetry-steps", "315"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"mine_lmo-test +lmo, test +3 +33\.3", text)
    (part,) = make_parts([tmp_path / "out"])
    table = part.sections[0].blocks[0].markdown()
    assert "CNOS-FastSAM + MegaPose" in table and "50.0" in table and "evaluation tests" in table
    assert "mine_lmo-test" in part.sections[1].blocks[0].markdown()
    (bare,) = make_parts([tmp_path / "out"], published=False)
    assert "MegaPose" not in bare.sections[0].blocks[0].markdown()
    assert main([*words, "--engine", "serial", "--errors", "mssd"]) == 1  # another setup
    assert "setup.symmetry_steps" in capsys.readouterr().err
