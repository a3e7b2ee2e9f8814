"""Faults of single frames: camera poses, objects that moved, shifted depth."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from toy_balls import Toy

from std_toolkit.checks.check_step import run_check
from std_toolkit.checks.gates.frames import FrameFaults, find_frame_faults
from std_toolkit.checks.gates.gate import Measured
from std_toolkit.checks.gates.judge import judge_rows, judge_scene
from std_toolkit.checks.inject.faults import Fault, apply_fault
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
GOOD, BAD, OPEN = (0.9, None), (0.35, None), (None, None)
SHIFTED = (0.8, [0.0, 8.0])
State = tuple[float | None, list[float] | None]


def make_object(object_id: int, states: list[State]) -> ObjectCheck:
    """An object with its share on edges and its shift in each frame; 0.3 on edges by chance."""
    rows = [
        ObjectFrameCheck(
            frame=i,
            visible_fraction=1.0,
            edge_px=1.0,
            edge_support=0.9,
            edge_chance_px=1.8,
            shift_px=shift,
            on_edges=share,
            on_edges_chance=None if share is None else 0.3,
        )
        for i, (share, shift) in enumerate(states)
    ]
    return ObjectCheck(
        object=object_id,
        name=f"o{object_id}",
        model="m",
        category="other",
        material="diffuse",
        label="propagated",
        frames_seen=len(rows),
        values=[
            Value(key=key, value=value, source="contour")
            for key, value in (("edge_px", 0.5), ("edge_support", 0.9), ("edge_chance_px", 1.8))
        ],
        frames=rows,
    )


def find(*objects: ObjectCheck, problem: str = "") -> FrameFaults:
    rows = [
        FrameCheck(frame=i, name=f"{i:03d}", status="registered", problem=problem if i == 0 else "")
        for i in range(len(objects[0].frames))
    ]
    return find_frame_faults(objects, rows, OPTIONS)


def judged(faults: FrameFaults) -> CheckReport:
    summary = SceneSummary(
        frames=8, registered=8, looked_at=8, objects=2, labelled=2, depth_frames=0, truth_frames=0
    )
    rows = Measured(summary=summary, objects=faults.objects, frames=faults.frames, options=OPTIONS)
    return judge_rows(rows)


def test_labels_that_fit_have_no_fault() -> None:
    found = find(make_object(1, [GOOD] * 8), make_object(2, [GOOD, OPEN] * 4))
    assert not found.camera and not found.moved
    assert {f.fault for f in found.frames} == {""}
    assert {f.fault for o in found.objects for f in o.frames} == {""}
    assert {judged(found).gate(k).status for k in ("camera", "moved", "unfit")} == {"pass"}


def test_an_object_off_in_one_frame_accuses_no_camera() -> None:
    off = [GOOD] * 3 + [SHIFTED] + [GOOD] * 4
    found = find(make_object(1, off), make_object(2, [GOOD] * 8), make_object(3, [GOOD] * 8))
    assert not found.camera and not found.moved
    assert [f.fault for f in found.objects[0].frames if f.fault] == ["shifted by 8.0 px"]


@pytest.mark.parametrize("state", [BAD, SHIFTED])
def test_all_objects_off_in_one_frame_accuse_the_camera(state: State) -> None:
    off = [GOOD] * 3 + [state] + [GOOD] * 4
    found = find(*(make_object(i, off) for i in (1, 2, 3)), problem="cannot be read")
    assert found.camera == [3] and not found.moved
    assert [f.fault for f in found.frames] == ["unreadable", "", "", "camera pose", "", "", "", ""]
    gate = judged(found).gate("camera")
    assert gate.status == "fail" and gate.value == 1 and gate.detail == "003"


@pytest.mark.parametrize(
    ("states", "between"),
    [
        ([GOOD] * 4 + [BAD] * 4, ((3, 4),)),
        ([SHIFTED] * 3 + [GOOD] * 5, ((2, 3),)),
        ([GOOD] * 2 + [BAD, SHIFTED, BAD] + [GOOD] * 3, ((1, 2), (4, 5))),
        ([GOOD, GOOD, OPEN, GOOD, OPEN, BAD, BAD, BAD], ((3, 5),)),
    ],
)
def test_an_object_that_moved_is_found(
    states: list[State], between: tuple[tuple[int, int], ...]
) -> None:
    found = find(make_object(1, states), make_object(2, [GOOD] * 8))
    (motion,) = found.moved
    assert motion.name == "o1" and motion.between == between
    assert not found.camera
    assert [f.frame for f in found.objects[0].frames if f.fault == "moved"] == [
        i for i, s in enumerate(states) if s in (BAD, SHIFTED)
    ]
    report = judged(found)
    assert {f.gate for f in report.objects[0].gates if f.verdict == "wrong"} == {"moved"}
    assert [o.verdict for o in report.objects] == ["wrong", "fits"]
    gate = report.gate("moved")
    assert gate.status == "fail" and f"between frames {between[0][0]:03d} and" in gate.detail


@pytest.mark.parametrize(
    "states", [[GOOD, BAD] * 4, [BAD] * 7 + [GOOD], [GOOD] * 6 + [BAD] * 2, [(0.5, None)] * 8]
)
def test_scattered_or_wrong_labels_did_not_move(states: list[State]) -> None:
    found = find(make_object(1, states), make_object(2, [GOOD] * 8))
    assert not found.moved and not found.camera


def test_a_hand_in_front_of_an_object_is_no_motion() -> None:
    states = [GOOD] * 30 + [BAD] * 3 + [GOOD] * 37
    assert not find(make_object(1, states), make_object(2, [GOOD] * 70)).moved
    longer = [GOOD] * 30 + [BAD] * 6 + [GOOD] * 34
    assert find(make_object(1, longer), make_object(2, [GOOD] * 70)).moved


def test_a_label_that_often_does_not_fit_fails() -> None:
    found = find(make_object(1, [GOOD, GOOD, BAD] * 4), make_object(2, [GOOD] * 12))
    gate = judged(found).gate("unfit")
    assert (gate.status, gate.value, gate.detail) == ("fail", 33.3, "o1")
    found = find(make_object(1, [GOOD] * 5 + [BAD]), make_object(2, [GOOD] * 6))
    assert judged(found).gate("unfit").status == "pass"


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
    assert [f.fault for f in report.frames] == ["", "", "camera pose", ""]
    assert "camera" in {g.key for g in report.failed_gates()}
    flags = read_check_flags(scene)
    assert flags is not None
    assert set(flags.frames) == {2} and {f for f, _ in flags.objects} <= {2}
    assert flags.frames[2] == "camera pose" and not flags.passed
    assert [g.key for g in flags.gates] == ["camera"]
