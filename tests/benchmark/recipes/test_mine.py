"""std-train mine: fine-tuning on frames that need no simulation, resumed; what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.cli.train import main
from benchmark.recipes.mine import (
    TUNINGS,
    MineReport,
    Score,
    fine_tune,
    plan_sets,
    report_lines,
)
from benchmark.recipes.recipe_run import Trained
from benchmark.training.options import Machine, MineOptions
from std_toolkit import RenderOptions, render_ground_truth
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import write_color
from std_toolkit.jobs import JobOptions
from tests.scene_on_disk import write_scene

MACHINE = Machine(accelerator="cpu", readers=0, progress=False)
SERIAL = JobOptions(engine="serial")


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    """Three labelled scenes with ground truth, of different images."""
    for i, name in enumerate("abc", 1):
        scene = write_scene(tmp_path / "scenes" / name, frames=2)
        for frame in scene.frames:
            write_color(scene.color_path(frame), scene.read_color(frame) // np.uint8(i))
        render_ground_truth(scene, RenderOptions(renderer="raycast")).raise_if_failed()
    return tmp_path / "scenes"


def options(scenes: Path, out: Path, **changes: object) -> MineOptions:
    given = {"method": "dfnet", "steps": 2, "batch_size": 2, "machine": MACHINE, "jobs": SERIAL}
    return MineOptions(scenes=scenes, out=out, **{**given, **changes})  # type: ignore[arg-type]


@pytest.mark.slow
def test_weights_are_tuned_and_scored_on_other_scenes(scenes: Path, tmp_path: Path) -> None:
    torch.set_num_threads(1)
    report = fine_tune(options(scenes, tmp_path / "out"))
    assert report.problems == {}
    assert report.weights.is_file()
    assert report.trained.scenes == 1  # of two: the other one chooses the best weights
    score = report.scores["scenes"]
    assert score.frames == 2
    assert score.before > 0 and score.after > 0 and score.before != score.after
    assert math.isnan(score.harm_before)  # the sensor of these scenes is exact
    assert (report.recommended is None) is (score.after >= score.before)
    assert {p.name for p in (tmp_path / "out/scenes/test").iterdir()} == {"c"}
    # The same command a second time does nothing.
    before = report.weights.stat().st_mtime_ns
    again = fine_tune(options(scenes, tmp_path / "out"))
    found = again.scores["scenes"]
    assert (found.before, found.after) == (score.before, score.after)
    assert report.weights.stat().st_mtime_ns == before


@pytest.mark.long
def test_the_command_goes_on_with_links_to_scenes(scenes: Path, tmp_path: Path, capsys) -> None:
    torch.set_num_threads(1)
    out = tmp_path / "out"
    words = ["mine", "--method", "dfnet", "--scenes", str(scenes), "--out", str(out)]
    words += ["--steps", "2", "--batch-size", "2", "--readers", "0", "--accelerator", "cpu"]
    words += ["--engine", "serial"]
    plan_sets(options(scenes, out))  # as a command that was killed after it leaves them
    (out / ".std").mkdir()
    (out / ".std/std-train-mine.lock").touch()
    assert main(words) == 0
    assert main(words) == 0
    assert "trained on 2 frames" in capsys.readouterr().out
    # A folder of links that is a link itself would be written through.
    (out / "scenes/train").rename(tmp_path / "elsewhere")
    (out / "scenes/train").symlink_to(tmp_path / "elsewhere")
    assert main(words) == 1
    assert "scenes/train: the folder is a symbolic link" in capsys.readouterr().err


def told(**scores: Score) -> tuple[MineReport, list[str]]:
    trained = Trained(frames=6, scenes=2, steps=3, batch_size=2, best_step=3)
    report = MineReport(Path("out/best.safetensors"), Path("out/results"), trained, scores=scores)
    return report, report_lines(report, "dfnet")


def test_worse_weights_are_not_recommended() -> None:
    interval = (0.03, 0.05)
    better = Score(4, 0.0413, 0.0381, interval, interval, 0.012, 0.011)
    worse = Score(4, 0.0381, 0.0413, interval, interval, 0.012, 0.011)
    report, lines = told(scenes=better)
    assert report.recommended == report.weights
    assert "--weights out/best.safetensors" in lines[-1]
    assert "harm 1.2% before, 1.1% after" in lines[1]
    for scores in ({"scenes": worse}, {"simulated": better, "scenes": worse}):
        report, lines = told(**scores)
        assert report.recommended is None
        assert "--weights" not in lines[-1]
        assert "scenes: the shipped weights are better and stay: RMSE 38.1 mm" in lines[-2]


def test_weights_that_harm_more_are_not_recommended() -> None:
    interval = (0.03, 0.05)
    for before, after, kept in ((0.002, 0.03, True), (0.002, 0.009, False), (0.05, 0.04, False)):
        score = Score(4, 0.05, 0.04, interval, interval, before, after)
        assert (told(simulated=score)[0].recommended is None) is kept, (before, after)
    unknown = Score(4, 0.05, 0.04, interval, interval)
    report, lines = told(simulated=unknown)
    assert report.recommended is not None
    assert not any("harm" in line for line in lines)
    same = Score(4, 0.05, 0.05, interval, interval)
    assert told(simulated=same)[0].recommended is None


def test_simulated_scenes_that_are_scored_are_others(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    given = MineOptions(meshes=tmp_path / "meshes", out=tmp_path / "out", simulated=30, tests=5)
    training, tests = plan_sets(given)
    assert len(training) == 1 and len(training[0].seeds) == 30
    scored = tests["simulated"]
    assert len(scored.seeds) == 5
    assert not set(training[0].seeds) & set(scored.seeds)
    assert max(scored.seeds) <= 99_999  # names of scenes have five digits
    assert training[0].root != scored.root
    assert scored.options is not None and scored.options.split == "all"


def test_what_cannot_be_used_is_named(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ToolkitError, match="swindrnet"):
        fine_tune(options(scenes, tmp_path / "out", method="lidf"))
    (scenes / "c").rename(tmp_path / "c")
    with pytest.raises(ToolkitError, match="at least 3 labelled scenes"):
        fine_tune(options(scenes, tmp_path / "out"))
    assert main(["mine", "--out", str(tmp_path / "out")]) == 2
    assert "--meshes" in capsys.readouterr().err


def test_a_tuning_is_that_of_the_card() -> None:
    """Fine-tuning goes on with the settings and the loss of the shipped weights."""
    cards = Path(__file__).resolve().parents[3] / "benchmark/weights"
    for method, tuning in TUNINGS.items():
        card = (cards / f"{method}-compact.md").read_text(encoding="utf-8")
        for field, values in (("settings", tuning.settings), ("loss", tuning.loss)):
            if values:
                row = ", ".join(f"{name}={value}" for name, value in values.items())
                assert f"| {field} | {row} |" in card, method


def test_every_mesh_is_read_before_any_is_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = tmp_path / "meshes" / "a" / "model.obj", tmp_path / "meshes" / "b" / "model.obj"
    for path, first in ((good, "0 0 0"), (bad, "nan 0 0")):
        path.parent.mkdir(parents=True)
        path.write_text(f"v {first}\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 2 3\nf 1 2 4\nf 1 3 4\n")
    words = ["mine", "--meshes", str(tmp_path / "meshes"), "--out", str(tmp_path / "out")]
    assert main(words) == 1
    assert f"{bad}: the mesh holds vertices that are not finite" in capsys.readouterr().err
    assert not (tmp_path / "out" / "sets").exists()
