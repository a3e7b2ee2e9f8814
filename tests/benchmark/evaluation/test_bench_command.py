"""`std-bench` from the command line: tables, exit status, and one line for what is wrong."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from benchmark.cli.bench import main
from benchmark.evaluation.tasks.depth_results import read_results
from benchmark.report.page import make_parts
from tests.benchmark.evaluation.bench_set import SPLIT, write_split

HERE = "tests.benchmark.evaluation.bench_set"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(tmp_path_factory.mktemp("data"), scenes=2, frames=2)


def bench(root: Path, out: Path, *more: str) -> int:
    usual = {"--data": str(root), "--split": SPLIT, "--out": str(out), "--engine": "serial"}
    places = [word for name, value in usual.items() if name not in more for word in (name, value)]
    return main([*places, *more])


@pytest.mark.slow
def test_a_leaderboard_in_the_terminal(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        bench(
            root,
            tmp_path,
            "--method",
            "raw",
            "nearest",
            "--no-speed",
            "--protocol",
            "strict",
            "paper",
        )
        == 0
    )
    text = capsys.readouterr().out
    assert "std-catknown, protocol strict, h126w224" in text
    assert "std-catknown, protocol paper, h224w126" in text
    assert len(re.findall(r"^nearest +all", text, re.M)) == 2
    results = read_results([tmp_path])
    assert {r.manifest.label for r in results} == {"raw", "nearest"}
    assert all(r.manifest.setup.frames == 4 and r.speed is None for r in results)


@pytest.mark.slow
def test_the_speed_is_measured(root: Path, tmp_path: Path) -> None:
    assert bench(root, tmp_path, "--method", "nearest") == 0
    (result,) = read_results([tmp_path])
    assert result.speed is not None
    assert result.speed.frames_per_s > 1
    assert (result.speed.width, result.speed.height) == (64, 36)
    assert result.speed.parameters is None
    assert result.speed.processor_s is not None and 0 < result.speed.processor_s < 1
    assert result.speed.load is not None and result.speed.load >= 0
    (part,) = make_parts([tmp_path])
    assert "processor_s" in part.files["leaderboard.csv"].splitlines()[0]


def test_frames_that_fail_end_with_another_status(root: Path, tmp_path: Path) -> None:
    status = bench(root, tmp_path, "--no-speed", "--method", f"{HERE}:WrongSize")
    assert status == 1
    assert read_results([tmp_path])[0].table["error"].ne("").all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--method", "swinnet"], "no plug-in with this name.*swinnet"),
        (["--method", "raw", "--protocol", "papers"], "papers"),
        (["--method", "raw", "--split", "std-catknow"], "std-catknow"),
        (["--method", "raw", "--data", "/nowhere"], "/nowhere: no such folder"),
        (["--method", "raw", "--split", "dreds-catnovel"], "nothing of this split"),
        (["--method", "swindrnet", "--weights", "/nowhere.pth"], "/nowhere.pth"),
        (["--method", "swindrnet", "--set", "fusion=new"], "fusion.*expected one of"),
        (["--method", "nlspn", "--device", "cuda", "--preset", "compact"], "cuda"),
        (["--method", "raw", "--depth-from", "/nowhere"], "/nowhere"),
    ],
)
def test_one_line_for_what_is_wrong(
    root: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    told: str,
) -> None:
    if "cuda" in arguments and _has_cuda():
        pytest.skip("this machine has CUDA")
    assert bench(root, tmp_path, "--no-speed", *arguments) == 1
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1, errors
    assert errors[0].startswith("error: ")
    assert re.search(told, errors[0])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "--method: needed"),
        (["--method", "raw", "--fit", "paper"], "--fit paper: not an option of std-bench depth"),
        (["--method", "raw", "--batch-size", "0"], "--batch-size: must be at least 1"),
        (["--method", "raw", "raw"], "--method: is given twice"),
        (["--method", "raw", "--precision", "int8"], "expected one of fp32, bf16, fp16"),
    ],
)
def test_wrong_usage_has_a_status_of_its_own(
    root: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    told: str,
) -> None:
    assert bench(root, tmp_path / "out", *arguments) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1, errors
    assert told in errors[0]
    assert not (tmp_path / "out").exists()


def test_figures_as_json(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench(root, tmp_path, "--method", "raw", "--no-speed", "--no-gallery", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows[0]["split"] == SPLIT
    assert (rows[0]["method"], rows[0]["protocol"], rows[0]["frames"]) == ("raw", "strict", 4)
    assert rows[0]["mae"] > 0


def test_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "methods"]) == 0
    methods = capsys.readouterr().out
    assert main(["list", "splits"]) == 0
    assert all(f"{name} " in methods for name in ("raw", "swindrnet", "nlspn"))
    assert "std-catknown" in capsys.readouterr().out
    assert main(["list", "methods", "--json"]) == 0
    names = [row["name"] for row in json.loads(capsys.readouterr().out)]
    assert names == [line.split()[0] for line in methods.splitlines()]


def test_what_of_a_split_is_there(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-data", str(root), "--split", SPLIT]) == 0
    assert "4" in capsys.readouterr().out
    assert main(["check-data", str(root), "--split", SPLIT, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["frames"] == 4
    assert main(["check-data", str(root), "--split", "dreds-catnovel"]) == 1


def _has_cuda() -> bool:
    import torch

    return torch.cuda.is_available()
