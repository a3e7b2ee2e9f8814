"""`submission.json`, classes of speed, and what rows say of methods."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.cli.report import PROGRAM
from benchmark.data.splits import open_split
from benchmark.evaluation.submission import Submission
from benchmark.evaluation.tasks.depth_results import read_results
from benchmark.evaluation.tasks.depth_speed import Speed, speed_class, standard_seconds
from benchmark.methods.depth.filling.filler import Nearest
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.methods.training_data import training_data
from tests.benchmark.evaluation.bench_set import SPLIT, write_split

STATED = {
    "training_data": "DREDS-CatKnown, 100,200 frames",
    "hardware": "a laptop",
    "device": "cpu",
    "cores": 2,
    "seconds_per_frame": 0.5,
    "width": 640,
    "height": 480,
    "citation": "@article{mine,\n  title = {Mine}\n}",
}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(tmp_path_factory.mktemp("data"), scenes=2, frames=2)


def predictions(root: Path, folder: Path, off: float) -> Path:
    source = open_split(SPLIT, root)
    for index, key in enumerate(source.keys()):
        path = folder / key.scene / f"{key.name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, source.load(index).depth_true + np.float32(off))
    return folder


def bench(root: Path, out: Path, *words: str) -> int:
    start = ["depth", "--data", str(root), "--split", SPLIT, "--out", str(out)]
    return main([*start, "--no-gallery", "--engine", "serial", *words])


def test_a_submission_reaches_rows_page_and_citations(root: Path, tmp_path: Path) -> None:
    one = predictions(root, tmp_path / "one", 0.01)
    two = predictions(root, tmp_path / "two", 0.02)
    (one / "submission.json").write_text(json.dumps(STATED))
    out = tmp_path / "out"
    assert bench(root, out, "--method", f"one={one}", f"two={two}", "raw", "--no-speed") == 0
    assert PROGRAM.main([str(out)]) == 0
    rows = pd.read_csv(out / "leaderboard.csv")
    rows = rows[(rows["grid"] == "h126w224") & (rows["subset"] == "all")].set_index("method")
    assert rows["speed_class"].to_dict() == {"one": "cpu", "two": "not stated", "raw": "not stated"}
    # Each is ranked among its class alone.
    assert rows["place"].to_dict() == {"one": 1, "two": 1, "raw": 2}
    assert rows.loc["one", "training_data"] == STATED["training_data"]
    assert rows.loc["one", "frames_per_s"] == 2 and rows.loc["one", "hardware"] == "a laptop"
    page = (out / "report.html").read_text()
    assert "a laptop" in page and STATED["training_data"] in page and "of its class" in page
    assert "title = {Mine}" in (out / "citations.bib").read_text()
    # What is said can change; what was scored is kept.
    (one / "submission.json").unlink()
    assert bench(root, out, "--method", f"one={one}", "--no-speed") == 0
    assert not list(out.rglob("submission.json"))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"seconds_per_frame": -1}, "seconds_per_frame"),
        ({"hardware": "<script>alert(1)</script>"}, "hardware"),
        ({"device": "tpu"}, "device"),
        ({"weights": "w.pth"}, "weights"),
        ({"citation": "a\x1b[2J"}, "citation"),
    ],
)
def test_a_wrong_submission_is_one_line(
    root: Path, tmp_path: Path, changes: dict, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = predictions(root, tmp_path / "one", 0.01)
    (folder / "submission.json").write_text(json.dumps(STATED | changes))
    assert bench(root, tmp_path / "out", "--method", f"one={folder}") == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "submission.json" in line and told in line


SPEED = Speed(
    frames_per_s=1, batch_size=1, width=1, height=1, repeats=1, parameters=None, gmacs=None,
    peak_memory_mib=1, hardware="x", standard_s=1.0,
)  # fmt: skip
AUTHOR = Submission(device="cpu", cores=2, seconds_per_frame=1.0, width=640, height=480)


@pytest.mark.parametrize(
    ("speed", "device", "said", "wanted"),
    [
        (SPEED, "cpu", None, "cpu"),
        (SPEED, "cuda", None, "gpu"),
        ({"standard_s": 1.01}, "cpu", None, "gpu"),
        ({"standard_s": None}, "cpu", None, "not stated"),
        (None, "cpu", {}, "cpu"),
        (None, "cpu", {"cores": 3}, "gpu"),  # maybe 1.5 s on two
        (None, "cpu", {"cores": 1}, "cpu"),
        (None, "cpu", {"width": 320}, "not stated"),
        (None, "cpu", {"cores": None}, "not stated"),
        (None, "cpu", {"seconds_per_frame": None}, "not stated"),
        (None, "cpu", {"device": ""}, "not stated"),
        (None, "cpu", {"device": "gpu", "seconds_per_frame": None}, "gpu"),
    ],
)
def test_classes_of_speed(speed: object, device: str, said: object, wanted: str) -> None:
    from msgspec.structs import replace as changed

    measured = changed(SPEED, **speed) if isinstance(speed, dict) else speed
    stated = changed(AUTHOR, **said) if isinstance(said, dict) else said
    assert speed_class(measured, device, stated) == wanted


def test_a_measured_method_has_a_class(root: Path, tmp_path: Path) -> None:
    assert bench(root, tmp_path, "--method", "nearest") == 0
    (result,) = read_results([tmp_path])
    assert result.speed is not None and 0 < result.speed.standard_s < 1
    assert result.speed_class == "cpu" and result.preset == "" and result.training_data == ""


def test_slow_methods_are_timed_whole(root: Path) -> None:
    class Slow(Nearest):
        input_size = (40, 30)

        def restore(self, views):
            assert views[0].camera.size == (40, 30)
            import time

            time.sleep(0.05)
            return super().restore(views)

    frame = open_split(SPLIT, root).load(0)
    assert 0.05 < standard_seconds(Slow(MethodOptions()), frame) < 1


def test_training_data_of_shipped_and_own_weights(tmp_path: Path) -> None:
    options = MethodOptions(preset="compact")
    shipped = training_data("dfnet", make_restorer("dfnet", options), options)
    assert shipped == "std-sim:dreds-catknown-train (1,680 frames of 336 scenes)"
    assert training_data("raw", make_restorer("raw"), MethodOptions()) == ""
    weights = tmp_path / "best.safetensors"
    weights.touch()
    own = replace(options, weights=weights)
    assert training_data("dfnet", object(), own) == ""
    part = {"split": "std-catknown", "frames": 12, "scenes": ["a", "b"], "simulation": {}}
    (tmp_path / "run.json").write_text(json.dumps({"training": [part]}))
    assert training_data("dfnet", object(), own) == "std-catknown (12 frames of 2 scenes)"
    (tmp_path / "run.json").write_text("[]")
    assert training_data("dfnet", object(), own) == ""
