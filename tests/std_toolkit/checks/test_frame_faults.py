"""Faults of single frames: camera poses, objects that moved, shifted depth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fault_table import BadFrames, FaultCase, Study, _camera_off
from toy_balls import Toy

from sensors.synthetic import scene_from_truth
from std_toolkit.checks.check_step import run_check
from std_toolkit.checks.gates.frames import FrameFaults, find_frame_faults
from std_toolkit.checks.gates.gate import Measured
from std_toolkit.checks.gates.judge import judge_rows, judge_scene
from std_toolkit.checks.inject.faults import Fault, FaultyScene, apply_fault
from std_toolkit.checks.measure.frame_evidence import FrameEvidence
from std_toolkit.checks.measure.frame_motion import Displaced
from std_toolkit.checks.measure.residuals import FrameObservation, measure_frame, open_for_work
from std_toolkit.checks.measure.sensor_depth import DepthShift, common_depth_shift
from std_toolkit.checks.result import (
    CheckReport,
    FrameCheck,
    ObjectCheck,
    ObjectFrameCheck,
    SceneSummary,
    Value,
)
from std_toolkit.geometry import SE3
from std_toolkit.jobs import JobOptions
from std_toolkit.options import CheckOptions
from std_toolkit.scene import CameraPoses, Scene
from std_toolkit.scene.check_flags import read_check_flags

OPTIONS = CheckOptions()
UP = np.array([0.0, 0.0, 1.0])


def make_object(object_id: int, depth_mm: dict[int, float] | None = None) -> ObjectCheck:
    """An object that fits, with a depth residual in some of its 8 frames."""
    rows = [
        ObjectFrameCheck(
            frame=i, visible_fraction=1.0, edge_px=1.0, depth_unscaled_mm=(depth_mm or {}).get(i)
        )
        for i in range(8)
    ]
    return ObjectCheck(
        object=object_id,
        name=f"o{object_id}",
        model="m",
        category="other",
        material="transparent",
        label="propagated",
        frames_seen=len(rows),
        values=[Value(key="edge_px", value=0.5, source="contour")],
        frames=rows,
    )


def displaced(*frames: int, mm: float = 20.0) -> Displaced:
    before = frames[0] - 1 if frames[0] else None
    after = frames[-1] + 1 if frames[-1] < 7 else None
    return Displaced(frames, before, after, np.zeros(6), np.eye(6), mm, 30.0)


def find(evidence: FrameEvidence, *objects: ObjectCheck, problem: str = "") -> FrameFaults:
    rows = [
        FrameCheck(frame=i, name=f"{i:03d}", status="registered", problem=problem if i == 0 else "")
        for i in range(8)
    ]
    return find_frame_faults(objects or [make_object(1)], rows, OPTIONS, evidence, up=UP)


def judged(evidence: FrameEvidence) -> CheckReport:
    summary = SceneSummary(
        frames=8, registered=8, looked_at=8, objects=2, labelled=2, depth_frames=0, truth_frames=0
    )
    found = find(evidence, make_object(1), make_object(2))
    return judge_rows(
        Measured(
            summary=summary,
            objects=found.objects,
            frames=found.frames,
            options=OPTIONS,
            evidence=evidence,
        )
    )


def test_frames_that_agree_have_no_fault() -> None:
    found = find(FrameEvidence())
    assert not found.moved
    assert {f.fault for f in found.frames} == {""}
    assert {f.fault for o in found.objects for f in o.frames} == {""}
    assert {judged(FrameEvidence()).gate(k).status for k in ("camera", "moved")} == {"pass"}


def test_a_wrong_camera_pose_is_named() -> None:
    evidence = FrameEvidence(camera={3: "30 mm and 2.0 deg off by its surroundings"})
    found = find(evidence, problem="cannot be read")
    said = "camera pose: 30 mm and 2.0 deg off by its surroundings"
    assert [f.fault for f in found.frames] == ["unreadable", "", "", said, "", "", "", ""]
    gate = judged(evidence).gate("camera")
    assert gate.status == "fail" and gate.value == 1 and gate.detail == "003"


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ((5, 6, 7), "o1 moved 20 mm between frames 004 and 005"),
        ((0, 1), "o1 moved 20 mm between frames 001 and 002"),
        ((3,), "o1 moved 20 mm between frames 002 and 003 and between frames 003 and 004"),
    ],
)
def test_an_object_that_moved_is_named(frames: tuple[int, ...], said: str) -> None:
    evidence = FrameEvidence(displaced={1: [displaced(*frames)]}, right=frozenset(frames))
    faults = [f.fault for f in find(evidence).objects[0].frames]
    assert faults == ["moved: 20 mm" if i in frames else "" for i in range(8)]
    report = judged(evidence)
    gate = report.gate("moved")
    assert gate.status == "fail" and gate.detail == said
    assert "moved" in {f.gate for f in report.objects[0].gates if f.verdict == "wrong"}
    assert not [f for f in report.objects[1].gates if f.gate == "moved" and f.verdict == "wrong"]


def test_one_object_does_not_tell_camera_and_object_apart() -> None:
    evidence = FrameEvidence(displaced={1: [displaced(3, mm=28.4)]})
    faults = [f.fault for f in find(evidence).objects[0].frames]
    assert faults[3] == "camera pose or object moved: 28 mm"
    gate = judged(evidence).gate("moved")
    assert gate.detail == "o1 moved or the camera pose is wrong in frame 003, by 28 mm"


def test_hidden_frames_are_told_and_no_fault() -> None:
    evidence = FrameEvidence(unseen={1: (2, 3, 6)})
    assert {f.fault for f in find(evidence).objects[0].frames} == {""}
    report = judged(evidence)
    assert report.gate("moved").status == report.gate("camera").status == "pass"
    (warning,) = (w for w in report.warnings if "not seen" in w.problem)
    assert warning.severity == "low" and warning.problem.endswith("2-3, 6")


@pytest.mark.parametrize(
    ("motion", "mm", "moved"),
    [
        ([0.008, 0, 0, 0, 0, 0.1], 8.0, True),  # it slid, and turned
        ([0.004, 0, 0.006, 0.08, 0, 0], 8.0, False),  # it would hang in the air, askew
        ([0.008, 0, 0.001, 0.01, 0, 0], 8.0, True),  # by the deviations it may have slid
        ([0.004, 0, 0.03, 0.6, 0, 0], 30.0, True),  # it fell over
    ],
)
def test_glass_that_moves_a_little_slides(motion: list[float], mm: float, moved: bool) -> None:
    covariance = np.diag([0.001**2] * 3 + [0.015**2] * 3)
    run = Displaced((3,), 2, 4, np.array(motion), covariance, mm, 9.0, 4.0)
    found = find(FrameEvidence(displaced={1: [run]}))
    assert [m.object for m in found.moved] == ([1] if moved else [])


def test_depth_is_a_fault_of_its_frame() -> None:
    found = find(FrameEvidence(), make_object(1, {2: 30.0, 3: 1.0}))
    assert [f.frame for f in found.objects[0].frames if f.fault] == [2]


def test_the_common_shift_of_depth_is_robust() -> None:
    shifts = [DepthShift(5.0 + 0.1 * i, -0.1 * i, 0.3, 100) for i in range(5)]
    found = common_depth_shift([*shifts, DepthShift(-9.0, 9.0, 0.3, 100)])
    assert found is not None
    assert (found.x_px, found.y_px) == pytest.approx((5.15, -0.15), abs=0.1)
    assert found.std_px < 0.5
    assert common_depth_shift([]) is None


def measured(scene: Scene) -> list[FrameObservation]:
    _, caster = open_for_work(scene.root, "faults")
    return [measure_frame(scene, caster, f, OPTIONS) for f in scene.frames]


@pytest.mark.slow
def test_shifted_depth_fails_with_its_shift(make_scene: Callable[[Toy], Scene]) -> None:
    scene = make_scene(Toy(frames=3, arc_deg=20))
    up = np.array([0.0, 1.0, 0.0])
    for shift_px, status in ((0, "pass"), (5, "fail")):
        faulty = apply_fault(scene, Fault("alignment", shift_px)) if shift_px else scene
        report = judge_scene(faulty, measured(faulty), {}, OPTIONS, up=up)
        (gate,) = (g for g in report.gates if g.key == "alignment")
        assert gate.status == status, gate
        assert report.summary.depth_shift_px == pytest.approx([shift_px, 0], abs=0.5)
        assert {bool(f.fault) for f in report.frames} == {status == "fail"}


@pytest.mark.slow
def test_the_exporters_read_the_faults_of_the_report(make_scene: Callable[[Toy], Scene]) -> None:
    """The wall behind the balls is plain: the two balls agree on the camera."""
    scene = make_scene(Toy(frames=4))
    assert scene.poses is not None
    poses = list(scene.poses.frames)
    off = SE3(np.eye(3), np.array([0.015, 0.0, 0.0]))
    T = scene.T_world_cam(2)
    assert T is not None
    poses[2] = msgspec.structs.replace(poses[2], T_world_cam=(T @ off).flat())
    assert read_check_flags(scene) is None
    scene.save_poses(CameraPoses(frames=poses))
    jobs = JobOptions(engine="serial", progress=False)
    report = run_check(scene, CheckOptions(overlay_frames=0), jobs)
    said = "camera pose: 2 objects moved as if the camera had"
    assert [f.fault for f in report.frames] == ["", "", said, ""]
    assert "camera" in {g.key for g in report.failed_gates()}
    flags = read_check_flags(scene)
    assert flags is not None
    assert set(flags.frames) == {2} and not flags.objects
    assert flags.frames[2].startswith("camera pose") and not flags.passed
    assert [g.key for g in flags.gates] == ["camera"]


def one_label(scene: Scene, name: str) -> FaultyScene:
    """The scene with the label of one object."""
    (item,) = (o for o in scene.objects.objects if o.name == name)
    labels = [x for x in scene.labels.labels if x.object == item.id]
    return FaultyScene(scene, labels=msgspec.structs.replace(scene.labels, labels=labels))


@pytest.mark.slow
def test_one_label_is_enough(synthetic_table: Path, tmp_path: Path) -> None:
    """With one labelled object, its surroundings tell a camera that is wrong from an object."""
    scene = one_label(scene_from_truth(synthetic_table, tmp_path / "scene"), "glass")
    (label,) = scene.labels.labels
    study = Study(scene)
    right = study.plain()
    assert {right.gate(k).status for k in ("camera", "moved")} == {"pass"}
    assert not [f for o in right.objects for f in o.frames if f.fault]
    frames = scene.registered_frames()
    for mm, deg in ((30.0, 2.0), (100.0, 5.0)):
        off = _camera_off(scene, frames[3].id, mm, deg)
        report = study.report(FaultCase("camera", "fail", off, frames=(frames[3].id,)))
        assert report.gate("camera").detail == frames[3].name
        assert report.gate("moved").status == "pass"
    bumped = apply_fault(scene, Fault("moved", 18, label.object))
    case = FaultCase("bump", "fail", bumped, frames=(frames[5].id,), objects=(label.object,))
    report = study.report(case)
    assert report.gate("camera").status == "pass"
    assert f"between frames {frames[4].name} and {frames[5].name}" in report.gate("moved").detail
    (item,) = (o for o in report.objects if o.object == label.object)
    assert [f.frame for f in item.frames if f.fault.startswith("moved")] == [frames[5].id]


@pytest.mark.slow
def test_an_object_behind_a_hand_did_not_move(synthetic_table: Path, tmp_path: Path) -> None:
    scene = one_label(scene_from_truth(synthetic_table, tmp_path / "scene"), "mug")
    frames = scene.registered_frames()
    hidden = {frames[2].id, frames[3].id}
    study = Study(scene)

    class Hand(BadFrames):
        def read_color(self, frame):  # type: ignore[no-untyped-def]
            image = super().read_color(frame).copy()
            camera = self.camera(frame)
            T = self.T_world_cam(frame.id)
            (label,) = self.labels.labels
            corners = self.mesh(self.objects.object(label.object).model).bounds
            at = self.T_world_obj(label.object) @ np.asarray(corners)
            uv = camera.project(T.inverse() @ at.mean(axis=0)[None])[0].astype(int)
            image[max(uv[1] - 75, 0) : uv[1] + 75, max(uv[0] - 75, 0) : uv[0] + 75] = 150
            return image

    case = FaultCase("hand", "pass", Hand(scene), frames=tuple(hidden))
    report = study.report(case)
    assert {report.gate(k).status for k in ("camera", "moved")} == {"pass"}
    assert not [f for o in report.objects for f in o.frames if f.fault.startswith("moved")]
    assert [w for w in report.warnings if "not seen in 2 frames" in w.problem]
