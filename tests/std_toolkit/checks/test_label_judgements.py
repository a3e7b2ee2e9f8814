"""The check stores its verdict with the label, and the verdict binds the commands that follow."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from toy_balls import Toy, write_toy

from std_toolkit.checks.check_step import run_check
from std_toolkit.checks.gates.hypotheses import JudgeSettings
from std_toolkit.checks.summary import summarise
from std_toolkit.cli.main import main
from std_toolkit.geometry.se3 import SE3
from std_toolkit.jobs import JobOptions
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.options import CheckOptions, RenderOptions
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene import Label, ObjectTable, Scene, SymmetryModel
from std_toolkit.scene.check_flags import report_is_current, scene_fingerprint
from std_toolkit.scene.judgement import Judgement
from std_toolkit.scene.label_verdicts import judgement_inputs, judgement_limits, label_verdicts
from std_toolkit.scene.model import ContinuousSymmetry
from std_toolkit.settings import override

SERIAL = JobOptions(engine="serial", progress=False)
TOY = Toy(frames=5)
WRONG = Toy(frames=5, moved={2: np.array([0.0, 0.012, 0.0])})
# No image tells how a ball is turned.
OPTIONS = CheckOptions(overlay_frames=0, max_motion_deg=20.0)
CHECK = ("--engine", "serial", "--overlay-frames", "0", "--max-motion-deg", "20")
RAYCAST = RenderOptions(renderer="raycast", policy="models")


def round_balls(scene: Scene) -> Scene:
    """The scene with balls that are declared as such."""
    axes = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    ball = SymmetryModel(continuous=[ContinuousSymmetry(axis=axis) for axis in axes])
    models = [msgspec.structs.replace(m, symmetry=ball) for m in scene.objects.models]
    scene.save_objects(ObjectTable(models=models, objects=scene.objects.objects))
    return scene


def judgements(root: Path) -> dict[int, Judgement]:
    labels = Scene.open(root).labels.labels
    return {x.object: x.judgement for x in labels if isinstance(x.judgement, Judgement)}


def grades(root: Path) -> dict[int, str]:
    return {v.object: v.grade for v in label_verdicts(Scene.open(root))}


def moved(scene: Scene, object_id: int, metres: float) -> None:
    label = scene.labels.of(object_id)
    assert label is not None and label.T_world_obj is not None
    T = SE3.from_matrix(label.T_world_obj)
    now = SE3(T.R, T.t + np.array([metres, 0.0, 0.0])).flat()
    scene.save_labels(scene.labels.with_label(msgspec.structs.replace(label, T_world_obj=now)))


@pytest.fixture(scope="module")
def wrong(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checked scene with ground truth: the label of ball 2 is wrong."""
    scene = round_balls(write_toy(tmp_path_factory.mktemp("wrong") / "scene", WRONG))
    with scene.lock():
        render_ground_truth(scene, RAYCAST, jobs=SERIAL)
    assert main(["check", str(scene.root), *CHECK]) == 1
    return scene.root


def test_a_check_makes_nothing_stale(make_scene: Callable[[Toy], Scene]) -> None:
    scene = round_balls(make_scene(TOY))
    propagate_labels(scene)
    with scene.lock():
        render_ground_truth(scene, RAYCAST, jobs=SERIAL)
    before = scene_fingerprint(scene)
    report = run_check(scene, OPTIONS, SERIAL)
    found = judgements(scene.root)
    assert {i: j.grade for i, j in found.items()} == {1: "fits", 2: "fits"}
    for judgement in found.values():
        assert judgement.probability is not None and judgement.probability > 0.9
        assert judgement.deviation_mm is not None and 0 < judgement.deviation_mm < 4
        assert "contour" in {e.source for e in judgement.evidence}
    scene = Scene.open(scene.root)
    assert scene_fingerprint(scene) == before and report_is_current(scene)
    data = (scene.root / "labels.json").read_bytes()
    propagate_labels(scene)
    assert run_check(scene, OPTIONS, SERIAL) == report
    with scene.lock():
        again = render_ground_truth(scene, RAYCAST, jobs=SERIAL)
    assert set(again.results.values()) == {"kept"}
    assert (scene.root / "labels.json").read_bytes() == data
    # Killed between the report and labels.json, or labels written again: the report has it all.
    scene.save_labels(scene.labels.without_judgements())
    page = scene.root / "check/report.html"
    written = page.stat().st_mtime_ns
    run_check(scene, OPTIONS, SERIAL)
    assert page.stat().st_mtime_ns == written and grades(scene.root) == {1: "fits", 2: "fits"}


def test_a_judgement_holds_for_its_pose_mesh_and_frames(
    make_scene: Callable[[Toy], Scene],
) -> None:
    scene = round_balls(make_scene(TOY))
    run_check(scene, OPTIONS, SERIAL)
    scene = Scene.open(scene.root)
    deviation = judgements(scene.root)[1].deviation_mm
    assert deviation is not None
    step = 0.06e-3 * deviation
    moved(scene, 1, step)
    assert grades(scene.root) == {1: "fits", 2: "fits"}
    # Nudges add up.
    moved(scene, 1, step)
    assert grades(scene.root) == {1: "unknown", 2: "fits"}
    assert "moved after the check" in label_verdicts(scene)[0].reason
    moved(scene, 1, -2 * step)
    assert grades(scene.root) == {1: "fits", 2: "fits"}
    # A label as annotated has no verdict, and propagation to the same pose keeps the old one.
    propagate_labels(scene)
    assert grades(scene.root) == {1: "fits", 2: "fits"}
    mesh = scene.root / "models/ball/ball.ply"
    mesh.write_bytes(mesh.read_bytes().replace(b"VCGLIB", b"vcglib") + b"\n")
    assert grades(scene.root) == {1: "unknown", 2: "unknown"}
    assert "mesh" in label_verdicts(Scene.open(scene.root))[0].reason


def test_propagation_drops_the_judgement_of_a_label_that_moved(
    make_scene: Callable[[Toy], Scene],
) -> None:
    scene = round_balls(make_scene(TOY))
    run_check(scene, OPTIONS, SERIAL)
    scene = Scene.open(scene.root)
    first = scene.labels.of(1)
    assert isinstance(first, Label)
    T = SE3.from_matrix(first.T_cam_obj)
    other = msgspec.structs.replace(first, T_cam_obj=SE3(T.R, T.t + np.array([0.003, 0, 0])).flat())
    scene.save_labels(scene.labels.with_label(other))
    propagate_labels(scene)
    assert set(judgements(scene.root)) == {2}


def test_a_wrong_label_fails_the_check_and_info_says_so(
    wrong: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert grades(wrong) == {1: "fits", 2: "wrong"}
    check = ["check", str(wrong), *CHECK]
    assert main(check) == 1
    said = capsys.readouterr().out
    assert "\nwrong: ball_2: " in said and "FAIL: wrong: ball_2" in said
    assert main([*check, "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert [o["verdict"] for o in report["objects"]] == ["fits", "wrong"]
    assert report["passed"] is False and report["limits"]["strict"] == 0
    assert main(["info", str(wrong)]) == 0
    lines = capsys.readouterr().out.splitlines()
    first = next(x for x in lines if x.startswith("verdict"))
    assert first.split()[1:3] == ["ball_1:", "fits"]
    assert any(x.startswith("verdict") and "ball_2: wrong" in x for x in lines)
    assert any(x.startswith("check") and "FAILED" in x for x in lines)
    assert "complete" not in lines[-1] and "ball_2" in lines[-1]
    assert main(["info", str(wrong), "--json"]) == 0
    verdicts = json.loads(capsys.readouterr().out)["verdicts"]
    assert [v["grade"] for v in verdicts] == ["fits", "wrong"]


def test_a_failed_gate_of_the_scene_is_in_info(
    make_scene: Callable[[Toy], Scene], capsys: pytest.CaptureFixture[str]
) -> None:
    scene = round_balls(make_scene(TOY))
    with scene.lock():
        render_ground_truth(scene, RAYCAST, jobs=SERIAL)
    arguments = ["check", str(scene.root), *CHECK]
    assert main([*arguments, "--max-reprojection-px", "0.1"]) == 1
    assert "FAIL: gate reprojection" in capsys.readouterr().out
    assert main(["info", str(scene.root)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(x.startswith("FAIL") and "reprojection: mean reprojection" in x for x in lines)
    assert "complete" not in lines[-1]
    out = scene.root.parent / "std"
    export = ["export", str(scene.root), "--format", "std", "--out", str(out)]
    assert main([*export, "--only", "fits"]) == 1
    assert "the check of the scene failed" in capsys.readouterr().err
    assert [p.name for p in scene.root.parent.iterdir()] == [scene.root.name]
    assert main([*export, "--allow-wrong"]) == 0
    quality = json.loads((out / "std_toolkit.json").read_text())["quality"]
    assert [g["key"] for g in quality["failed_gates"]] == ["reprojection"]
    assert "Failed gate reprojection" in (out / "dataset_info.md").read_text()


@pytest.mark.parametrize("layout", ["std", "bop", "nocs"])
def test_an_export_of_a_wrong_label_is_refused_or_says_so(
    wrong: Path, tmp_path: Path, layout: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    export = ["export", str(wrong), "--format", layout, "--out", str(out), "--engine", "serial"]
    assert main(export) == 1
    said = capsys.readouterr().err
    assert "the label of ball_2 is wrong" in said and "--allow-wrong" in said
    assert list(tmp_path.iterdir()) == []
    assert main([*export, "--allow-wrong"]) == 0
    sidecar = json.loads((out / "std_toolkit.json").read_text())
    assert sidecar["quality"]["checked"] is True
    first, second = sidecar["quality"]["labels"]
    assert (first["grade"], second["grade"]) == ("fits", "wrong")
    assert first["probability"] > 0.9 and first["failed_gates"] == []
    assert second["failed_gates"] and second["deviation_mm"] > 0
    assert all("judgement" not in label for label in sidecar["labels"]["labels"])
    card = (out / "dataset_info.md").read_text()
    assert "| ball_2 | yes | wrong |" in card
    if layout == "bop":
        info = json.loads((out / "dataset_info.json").read_text())
        assert [x["grade"] for x in info["labels"]["labels"]] == ["fits", "wrong"]

    assert main([*export, "--only", "fits", "--overwrite"]) == 0
    said = capsys.readouterr().out
    assert "left out 1 objects whose label does not fit: ball_2" in said
    sidecar = json.loads((out / "std_toolkit.json").read_text())
    assert [x["name"] for x in sidecar["left_out_objects"]] == ["ball_2"]
    assert sidecar["left_out_objects"][0]["reason"].startswith("wrong: ")
    assert [x["object"] for x in sidecar["labels"]["labels"]] == [1]
    assert {o["object"] for f in sidecar["frames"] for o in f["objects"]} == {1}
    assert [x["grade"] for x in sidecar["quality"]["labels"]] == ["fits", "wrong"]


def test_unchecked_labels_are_exported_as_unknown(
    make_scene: Callable[[Toy], Scene], capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene(Toy(frames=2))
    with scene.lock():
        render_ground_truth(scene, RAYCAST, jobs=SERIAL)
    out = scene.root.parent / "std"
    export = ["export", str(scene.root), "--format", "std", "--out", str(out)]
    assert main([*export, "--only", "fits"]) == 1
    assert "no object is left" in capsys.readouterr().err and not out.exists()
    assert main(export) == 0
    assert "unknown: ball_1: the label was not checked" in capsys.readouterr().out
    quality = json.loads((out / "std_toolkit.json").read_text())["quality"]
    assert quality["checked"] is False
    assert {x["grade"] for x in quality["labels"]} == {"unknown"}
    assert summarise(scene).next_command == f"std-curate check {scene.root}"


def test_a_judgement_holds_for_its_limits(make_scene: Callable[[Toy], Scene]) -> None:
    scene = round_balls(make_scene(TOY))
    loose = CheckOptions(overlay_frames=0, max_motion_deg=20.0, max_motion_mm=50.0)
    run_check(scene, loose, SERIAL)
    found = label_verdicts(Scene.open(scene.root))
    assert [v.grade for v in found] == ["fits", "fits"]
    # The verdict says by which limits.
    assert "max_motion_mm 50" in found[0].line()
    # So it does in a copy without the records, which may be deleted.
    copy = scene.root.with_name("copy")
    shutil.copytree(scene.root, copy, ignore=shutil.ignore_patterns(".std"))
    assert [v.line() for v in label_verdicts(Scene.open(copy))] == [v.line() for v in found]
    wide = Scene.open(scene.root).labels
    # Evidence for wider limits than those of the present check says nothing.
    run_check(scene, OPTIONS, SERIAL)
    narrow = Scene.open(scene.root).labels
    assert grades(scene.root) == {1: "fits", 2: "fits"}
    scene.save_labels(wide)
    assert grades(scene.root) == {1: "unknown", 2: "unknown"}
    assert "other limits" in label_verdicts(Scene.open(scene.root))[0].reason
    # The page is no evidence, and what fits narrow limits fits wider ones.
    run_check(scene, loose, SERIAL)
    scene.save_labels(narrow)
    assert grades(scene.root) == {1: "fits", 2: "fits"}
    # Settings count as well.
    limits = judgement_limits(OPTIONS.label_limits())
    assert limits == {"max_motion_deg": 20.0}
    with override(JudgeSettings(right_prior=0.2)):
        assert judgement_limits() == {"checks.gates.hypotheses.right_prior": 0.2}
        assert judgement_inputs(scene) != judgement_inputs(scene, {})
        assert grades(scene.root) == {1: "unknown", 2: "unknown"}
