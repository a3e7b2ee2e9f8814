"""The whole step on a small recording with known truth."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Similarity, rotation_angle, umeyama
from std_toolkit.poses import PoseOptions, mapping
from std_toolkit.poses.pose_gates import (
    _at_least,
    _at_most,
    _position_sigma,
    _stretches,
    failed_gates,
)
from std_toolkit.poses.pose_step import estimate_poses
from std_toolkit.scene import Frame, FramePose, Label, Labels, Model, Object, ObjectTable, Scene
from std_toolkit.scene.scene import require_metres
from std_toolkit.settings import override

SERIAL = PoseOptions(threads=1)


def check_against_truth(scene: Scene, truth: list, *, metric: float) -> None:
    """Every pose relative to the first: 0.3 degrees, 3 mm; the scale to `metric`."""
    frames = [f.id for f in scene.registered_frames()]
    ours = [scene.T_world_cam(i) for i in frames]
    fit = umeyama(np.array([T.t for T in ours]), np.array([truth[i].t for i in frames]))
    assert abs(fit.scale - 1) < metric
    for i, T in zip(frames, ours, strict=True):
        T_first_cam = ours[0].inverse() @ T
        scaled = SE3(T_first_cam.R, fit.scale * T_first_cam.t)
        error = scaled.inverse() @ (truth[frames[0]].inverse() @ truth[i])
        assert np.degrees(rotation_angle(error.R)) < 0.3
        assert np.linalg.norm(error.t) < 3e-3


@pytest.fixture(scope="module")
def solved(recording, tmp_path_factory) -> Scene:
    """A scene with depth, solved once with one thread; tests copy it."""
    scene = recording.write(tmp_path_factory.mktemp("poses") / "scene")
    estimate_poses(scene, SERIAL)
    return scene


@pytest.fixture
def copy(solved: Scene, tmp_path: Path) -> Scene:
    shutil.copytree(solved.root, tmp_path / "scene")
    return Scene.open(tmp_path / "scene")


def test_poses_in_metres_match_the_truth(solved: Scene, recording) -> None:
    poses = solved.poses
    assert poses is not None
    assert [p.status for p in poses.frames] == ["registered"] * len(recording.colors)
    assert failed_gates(poses) == []
    assert poses.scale is not None and poses.scale.unit == "metre"
    assert poses.scale.chosen == "depth"
    assert poses.cameras == {}  # nothing was refined
    check_against_truth(solved, recording.truth, metric=5e-3)
    first = solved.T_world_cam(0)
    assert first is not None and np.allclose(first.matrix(), np.eye(4), atol=1e-9)


def test_covariance_predicts_the_error(solved: Scene, recording) -> None:
    assert solved.poses is not None
    truth = recording.truth
    ours = [solved.T_world_cam(i) for i in range(len(truth))]
    # The world frames are aligned by the rotations: camera centres on a short arc leave the turn
    # about that arc open.
    U, _, Vt = np.linalg.svd(sum(b.R @ a.R.T for a, b in zip(ours, truth, strict=True)))
    R = U @ Vt
    centres, exact = np.array([T.t for T in ours]) @ R.T, np.array([T.t for T in truth])
    spread, goal = centres - centres.mean(axis=0), exact - exact.mean(axis=0)
    scale = np.sum(spread * goal) / np.sum(spread**2)
    fit = Similarity(scale, R, exact.mean(axis=0) - scale * centres.mean(axis=0))
    ratio = []
    for pose in solved.poses.frames:
        T = solved.T_world_cam(pose.frame)
        assert T is not None and pose.covariance is not None
        sigma = np.sqrt(np.diag(np.reshape(pose.covariance, (6, 6))))
        assert (sigma > 0).all()
        error = fit.transform_pose(T).inverse() @ truth[pose.frame]
        ratio.append(np.abs(error.log()) / sigma)
    assert 0.05 < np.median(ratio) < 5


@pytest.mark.slow
def test_many_keyframes_are_mapped_as_well(copy: Scene, recording, monkeypatch) -> None:
    """They are adjusted less often while the model grows."""
    asked = []
    less = mapping._adjust_less
    monkeypatch.setattr(mapping, "_adjust_less", lambda p: (less(p), asked.append(p)))
    shutil.rmtree(copy.root / ".std")
    with override(mapping.MappingSettings(many_images=2)):
        poses = estimate_poses(copy, SERIAL)
    assert asked[0].ba_global_frames_ratio == 1.5
    assert failed_gates(poses) == []
    assert len(copy.registered_frames()) == len(recording.colors)
    check_against_truth(copy, recording.truth, metric=5e-3)


def test_a_second_run_does_nothing(copy: Scene, caplog) -> None:
    path = copy.root / "poses.json"
    before = path.read_bytes(), path.stat().st_mtime_ns
    with caplog.at_level("INFO", logger="std_toolkit"):
        estimate_poses(copy, SERIAL)
    assert "poses: kept" in caplog.text
    assert (path.read_bytes(), path.stat().st_mtime_ns) == before


@pytest.mark.slow
def test_a_changed_image_or_option_is_noticed(copy: Scene, caplog) -> None:
    with caplog.at_level("INFO", logger="std_toolkit"):
        estimate_poses(copy, PoseOptions(threads=1, scale="none"))
    assert "using the model of the last run" in caplog.text
    assert copy.poses is not None and copy.poses.scale is not None
    assert copy.poses.scale.unit == "unknown"
    with pytest.raises(ToolkitError, match="unit of these camera poses is unknown"):
        require_metres(copy)
    color = copy.color_path(copy.frames[3])
    shutil.copy(copy.color_path(copy.frames[4]), color)
    caplog.clear()
    with caplog.at_level("INFO", logger="std_toolkit"):
        estimate_poses(copy, SERIAL)
    assert "using the model of the last run" not in caplog.text


@pytest.mark.slow
def test_one_thread_and_seed_give_identical_bytes(solved: Scene, recording, tmp_path: Path) -> None:
    again = recording.write(tmp_path / "again")
    estimate_poses(again, SERIAL)
    assert (again.root / "poses.json").read_bytes() == (solved.root / "poses.json").read_bytes()


@pytest.mark.slow
def test_nothing_to_tell_the_metres(recording, tmp_path: Path, caplog) -> None:
    scene = recording.write(tmp_path / "scene", depth=False)
    with caplog.at_level("WARNING", logger="std_toolkit"):
        poses = estimate_poses(scene, SERIAL)
    assert "UNKNOWN" in caplog.text
    assert poses.scale is not None and poses.scale.unit == "unknown"
    with pytest.raises(ToolkitError, match="no board is described"):
        estimate_poses(scene, PoseOptions(threads=1, scale="board"))
    with pytest.raises(ToolkitError, match="unknown scale source"):
        estimate_poses(scene, PoseOptions(threads=1, scale="ruler"))


def test_depth_correction_scales_the_poses(copy: Scene) -> None:
    import msgspec

    assert copy.poses is not None and copy.poses.scale is not None
    before = copy.poses.scale.estimates[0].factor
    copy.save_info(msgspec.structs.replace(copy.info, depth_correction=0.98))
    estimate_poses(copy, SERIAL)
    assert copy.poses is not None and copy.poses.scale is not None
    after = copy.poses.scale.estimates[0].factor
    assert after / before == pytest.approx(0.98, rel=1e-6)


@pytest.mark.slow
def test_a_frame_that_shows_something_else_is_marked_not_guessed(recording, tmp_path: Path) -> None:
    nine = {name: value[3:12] for name, value in vars(recording).items()}
    scene = dataclasses.replace(recording, **nine).write(tmp_path / "scene")
    rng = np.random.default_rng(0)
    from std_toolkit.io.images import write_color

    noise = rng.integers(0, 255, size=(45, 60, 3)).astype(np.uint8)
    write_color(scene.color_path(scene.frames[6]), np.kron(noise, np.ones((8, 8, 1), np.uint8)))
    poses = estimate_poses(scene, PoseOptions(threads=1, min_registered=0.99))
    lost = poses.frames[6]
    assert lost.status == "unregistered" and lost.T_world_cam is None
    assert sum(p.status == "registered" for p in poses.frames) == 8
    failed = failed_gates(poses)
    assert failed and "000006" in failed[0] and "record again" in failed[0]
    assert (scene.root / "poses.json").is_file()


def test_a_blank_recording_is_refused(recording, tmp_path: Path) -> None:
    from std_toolkit.io.images import write_color

    scene = recording.write(tmp_path / "scene", depth=False)
    for frame in scene.frames:
        write_color(scene.color_path(frame), np.full((360, 480, 3), 200, np.uint8))
    with pytest.raises(ToolkitError, match="almost no features"):
        estimate_poses(scene, SERIAL)
    assert not (scene.root / "poses.json").exists()


def test_a_truncated_image_is_named_and_the_scene_left_alone(copy: Scene) -> None:
    before = (copy.root / "poses.json").read_bytes()
    path = copy.color_path(copy.frames[2])
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(ToolkitError, match=r"000002\.png"):
        estimate_poses(copy, SERIAL)
    assert (copy.root / "poses.json").read_bytes() == before
    assert not (copy.root / ".std" / "work" / "poses").exists()


def test_labels_of_the_old_world_are_forgotten(copy: Scene) -> None:
    copy.save_objects(
        ObjectTable(
            models=[Model(id="m", mesh="models/m/m.ply", size_m=[0.1] * 3, diameter_m=0.17)],
            objects=[Object(id=1, name="m", model="m", material="diffuse")],
        )
    )
    pose = SE3(np.eye(3), np.array([0.0, 0.0, 0.5])).flat()
    label = Label(object=1, frame=0, T_cam_obj=pose, T_world_obj=pose, refined=True)
    copy.save_labels(Labels(labels=[label]))
    estimate_poses(copy, PoseOptions(threads=1, scale="none"))
    (kept,) = Scene.open(copy.root).labels.labels
    assert (kept.T_cam_obj, kept.T_world_obj, kept.refined) == (pose, None, False)


def test_files_of_the_user_survive_a_new_run(copy: Scene) -> None:
    """A peer's reconstruction step empties the folder that it works in."""
    mine = [
        copy.root / "notes.txt",
        copy.root / "poses" / "notes.txt",
        copy.root / "color" / "x.md",
    ]
    for path in mine:
        path.write_text("keep me")
    estimate_poses(copy, PoseOptions(threads=1, scale="none"))
    assert [path.read_text() for path in mine] == ["keep me"] * 3


def test_an_unknown_scale_source_is_refused_before_the_mapping(recording, tmp_path: Path) -> None:
    scene = recording.write(tmp_path / "scene")
    with pytest.raises(ToolkitError, match="unknown scale source"):
        estimate_poses(scene, PoseOptions(scale="bord"))
    assert not (scene.root / ".std" / "poses").exists()


def test_command_line(copy: Scene, capsys) -> None:
    assert main(["--quiet", "poses", str(copy.root), "--threads", "1"]) == 0
    out = capsys.readouterr().out
    assert "registered 14 of 14 frames" in out
    assert "z over z" in out
    failing = ["--quiet", "poses", str(copy.root), "--threads", "1", "--max-reprojection-px"]
    assert main([*failing, "0.0001"]) == 1
    assert "FAILED mean_reprojection_px" in capsys.readouterr().out


@pytest.mark.slow
def test_global_mapper_and_refined_distortion(copy: Scene, recording) -> None:
    from std_toolkit.options import Mapper, Refinement

    estimate_poses(copy, PoseOptions(threads=1, mapper=Mapper.GLOBAL))
    check_against_truth(copy, recording.truth, metric=5e-3)
    estimate_poses(copy, PoseOptions(threads=1, refine=Refinement.DISTORTION))
    assert copy.poses is not None
    refined = copy.poses.cameras["color"]
    assert refined.fx == pytest.approx(420.0, rel=0.03)
    # There is no distortion in this recording: none of more than a pixel may be found.
    camera = refined.camera()
    rays = camera.without_distortion().rays()
    moved = camera.project(rays) - camera.without_distortion().project(rays)
    assert len(refined.distortion) == 4 and np.abs(moved).max() < 1.0


@pytest.mark.slow
def test_killed_runs_leave_nothing_and_keep_finished_features(recording, tmp_path: Path) -> None:
    scene = recording.write(tmp_path / "scene")
    command = [sys.executable, "-m", "std_toolkit.cli.main", "poses", str(scene.root)]
    rng = np.random.default_rng(0)
    features = scene.root / ".std" / "poses" / "features"
    made: dict[str, int] = {}
    for delay in rng.uniform(0.8, 4.0, size=5):
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        time.sleep(delay)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        now = {p.name: p.stat().st_mtime_ns for p in features.glob("[!.]*.npz")}
        assert all(now[name] == when for name, when in made.items())
        made = now
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    assert not list(scene.root.rglob("*.tmp*"))
    assert not (scene.root / ".std" / "work" / "poses").exists()
    check_against_truth(Scene.open(scene.root), recording.truth, metric=5e-3)


def test_the_deviation_of_a_position_is_that_of_all_three_axes() -> None:
    def pose(*sigma: float) -> FramePose:
        C = np.diag([*np.square(sigma), 9.0, 9.0, 9.0])
        return FramePose(
            frame=0,
            status="registered",
            T_world_cam=SE3.identity().flat(),
            covariance=C.ravel().tolist(),
        )

    assert _position_sigma([pose(1, 2, 2), pose(2, 3, 6), pose(4, 4, 7)], 2.0) == pytest.approx(3.5)
    assert _position_sigma([], 2.0) == float("inf")


def test_a_gate_passes_at_its_limit_and_on_its_side_of_it() -> None:
    assert [_at_least("g", v, 0.9, "do").passed for v in (0.89, 0.9, 0.95)] == [False, True, True]
    assert [_at_most("g", v, 0.9, "do").passed for v in (0.89, 0.9, 0.95)] == [True, True, False]
    unknown = _at_most("g", float("nan"), 0.9, "do")
    assert (unknown.passed, unknown.value, unknown.advice) == (False, 1e9, "do")


def test_lost_frames_are_told_as_runs() -> None:
    frames = [Frame(id=i, name=f"f{i}", color=f"color/f{i}.png") for i in range(8)]
    assert _stretches(frames, ["f1", "f3", "f4", "f5"]) == "frame f1, f3..f5"
    lost = ["f0", "f2", "f4", "f6", "f7"]
    assert _stretches(frames, lost) == "frame f0, f2, f4, f6..f7"
