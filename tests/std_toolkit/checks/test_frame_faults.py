"""Faults of single frames in the report, and what the exporters read of them."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from toy_balls import Toy

from std_toolkit.checks.check_step import run_check
from std_toolkit.checks.frame_faults import with_frame_faults, with_object_faults
from std_toolkit.checks.result import FrameCheck, ObjectCheck, ObjectFrameCheck
from std_toolkit.geometry import SE3
from std_toolkit.jobs import JobOptions
from std_toolkit.options import CheckOptions
from std_toolkit.scene import CameraPoses, Scene
from std_toolkit.scene.check_flags import read_check_flags


def make_object(object_id: int, shifts_px: list[float]) -> ObjectCheck:
    rows = [
        ObjectFrameCheck(frame=i, visible_fraction=1.0, edge_support=0.9, shift_px=[0.0, s])
        for i, s in enumerate(shifts_px)
    ]
    item = ObjectCheck(
        object=object_id,
        name=f"o{object_id}",
        model="m",
        category="other",
        material="diffuse",
        label="propagated",
        frames=rows,
    )
    return with_object_faults(item, CheckOptions())


def frame_faults(*objects: ObjectCheck, problem: str = "") -> list[str]:
    rows = [
        FrameCheck(frame=i, name=f"{i}", status="registered", problem=problem if i == 0 else "")
        for i in range(5)
    ]
    return [r.fault for r in with_frame_faults(rows, objects)]


def test_an_object_off_in_one_frame_is_no_fault_of_the_camera() -> None:
    moved, still = make_object(1, [0.2, 0.1, 8.0, 0.3, 0.2]), make_object(2, [0.1] * 5)
    assert [f.fault for f in moved.frames] == ["", "", "shifted by 8.0 px", "", ""]
    assert frame_faults(moved, still) == [""] * 5


def test_all_objects_off_in_one_frame_are_a_fault_of_the_camera() -> None:
    objects = [make_object(i, [0.2, 0.1, 8.0, 0.3, 0.2]) for i in (1, 2, 3)]
    assert frame_faults(*objects) == ["", "", "camera pose", "", ""]


def test_wrong_labels_accuse_no_camera() -> None:
    objects = [make_object(i, [8.0, 7.0, 9.0, 8.0, 0.2]) for i in (1, 2)]
    assert frame_faults(*objects, problem="cannot be read") == ["unreadable", "", "", "", ""]


def test_a_shift_without_edges_is_no_fault() -> None:
    item = make_object(1, [8.0])
    dim = [msgspec.structs.replace(f, edge_support=0.1, fault="") for f in item.frames]
    weak = with_object_faults(msgspec.structs.replace(item, frames=dim), CheckOptions())
    assert weak.frames[0].fault == ""


@pytest.mark.slow
def test_the_exporters_read_the_faults_of_the_report(make_scene: Callable[[Toy], Scene]) -> None:
    scene = make_scene(Toy(frames=5))
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
    assert [bool(f.fault) for f in report.frames] == [False, False, True, False, False]
    flags = read_check_flags(scene)
    assert flags is not None
    assert set(flags.frames) == {2} and {f for f, _ in flags.objects} <= {2}
    assert "camera" in flags.of_frame(2)
