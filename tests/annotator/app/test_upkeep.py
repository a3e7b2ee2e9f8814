"""Table, penetration and residuals follow the edits by themselves."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from desk_without_window import Desk
from scene_on_disk import camera_pose, camera_poses, write_scene

from annotator.app import operations, pose_checks
from annotator.app.background_updates import BackgroundUpdates
from annotator.app.object_summary import summarize
from annotator.session import AddObject, Move, PoseChange, RemoveObject, SetPoses
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene").root)
    made.controller.select("box_1")
    yield made
    made.close()


@pytest.fixture
def upkeep(desk: Desk) -> Iterator[BackgroundUpdates]:
    made = BackgroundUpdates(desk.controller)
    yield made
    made.close()


def measured(desk: Desk) -> bool:
    return "box_1" in desk.controller.residuals


@pytest.mark.slow
def test_what_is_known_of_a_scene_comes_by_itself(desk: Desk, upkeep: BackgroundUpdates) -> None:
    desk.wait(lambda: measured(desk) and desk.controller.table is not None)
    assert [row.frame for row in desk.controller.residuals["box_1"]] == [0, 1, 2]
    table = desk.controller.table
    assert table is not None
    assert table.plane.signed_distance([0.0, 0.0, 0.8]) == pytest.approx(0, abs=0.01)


@pytest.mark.slow
def test_residuals_of_an_object_that_moved_are_gone_at_once(
    desk: Desk, upkeep: BackgroundUpdates
) -> None:
    desk.wait(lambda: measured(desk))
    desk.controller.nudge(shift=(1, 0, 0))
    assert not measured(desk)
    desk.wait(lambda: measured(desk))


@pytest.mark.slow
def test_another_object_does_not_take_them_away(desk: Desk, upkeep: BackgroundUpdates) -> None:
    desk.wait(lambda: measured(desk))
    desk.controller.apply(AddObject(object="box_2", model="box"))
    assert measured(desk)


@pytest.mark.slow
def test_an_object_that_is_removed_meanwhile_raises_no_error(
    desk: Desk, upkeep: BackgroundUpdates, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure = pose_checks.measure_objects
    removed = threading.Event()

    def slowly(*args: Any) -> Any:
        rows = measure(*args)
        assert removed.wait(30)
        return rows

    desk.wait(lambda: measured(desk))
    monkeypatch.setattr(pose_checks, "measure_objects", slowly)
    desk.controller.nudge(shift=(1, 0, 0))
    desk.rest(1.2)  # until it is being measured
    desk.controller.apply(RemoveObject(object="box_1"))
    removed.set()
    desk.rest(0.5)
    assert desk.messages == []


@pytest.mark.slow
def test_a_drag_that_is_given_up_lets_the_work_go_on(desk: Desk, upkeep: BackgroundUpdates) -> None:
    controller = desk.controller
    pose = controller.pose("box_1", 0)
    assert pose is not None
    controller.nudge(shift=(1, 0, 0))
    controller.drag_to("box_1", 0, pose)  # cancels what the nudge has asked for
    desk.rest(1.5)
    assert not measured(desk)
    controller.cancel()
    desk.wait(lambda: measured(desk))


@pytest.mark.slow
def test_objects_in_one_place_are_told_and_told_again_when_they_part(
    desk: Desk, upkeep: BackgroundUpdates
) -> None:
    controller = desk.controller
    pose = controller.pose("box_1", 0)
    assert pose is not None
    controller.apply(AddObject(object="box_2", model="box"))
    near = SE3(pose.R, pose.t + np.array([0.01, 0.0, 0.0]))
    controller.apply(SetPoses.one("box_2", 0, near, method="typed"))
    desk.wait(lambda: bool(controller.penetrations))
    assert {controller.penetrations[0].first, controller.penetrations[0].second} == {
        "box_1",
        "box_2",
    }
    controller.apply(Move(object="box_2", frame=0, shift_mm=[200, 0, 0]))
    desk.wait(lambda: not controller.penetrations)


@pytest.mark.slow
def test_in_another_world_the_table_is_looked_for_again(
    desk: Desk, upkeep: BackgroundUpdates
) -> None:
    """Camera poses that are recovered anew have a world frame of their own."""
    controller, root = desk.controller, desk.session.scene.root
    desk.wait(lambda: controller.table is not None)
    before = controller.table
    assert before is not None
    T_new_old = SE3.exp([0.3, -0.2, 0.1, 0.2, 0.4, -0.1])
    poses = camera_poses([T_new_old @ camera_pose(i) for i in range(3)])
    Scene.open(root).save_poses(poses)
    desk.session.reload()
    assert controller.table is None
    desk.wait(lambda: controller.table is not None)
    assert controller.table is not None
    moved = before.plane.moved(T_new_old, "world")
    assert controller.table.plane.normal == pytest.approx(moved.normal, abs=1e-3)
    assert controller.table.plane.offset == pytest.approx(moved.offset, abs=1e-3)


@pytest.mark.slow
def test_what_runs_into_each_other_in_one_frame_is_not_told_of_others(tmp_path: Path) -> None:
    """Without camera poses each frame has poses of its own."""
    desk = Desk(write_scene(tmp_path / "loose", labelled=False).root)
    c, kept = desk.controller, BackgroundUpdates(desk.controller)
    c.apply(AddObject(object="box_2", model="box"))
    for frame, x in ((0, 0.01), (1, 0.3)):
        c.apply(SetPoses.one("box_1", frame, SE3.exp([0, 0, 0.6, 0, 0, 0]), method="typed"))
        c.apply(SetPoses.one("box_2", frame, SE3.exp([x, 0, 0.6, 0, 0, 0]), method="typed"))
    desk.wait(lambda: bool(c.penetrations))
    assert len(c.penetrations_in(0)) == 1
    assert c.penetrations_in(1) == c.penetrations_in(2) == ()
    assert summarize(c)[0].alarm.endswith("into box_2")
    c.show_frame(1)
    assert summarize(c)[0].alarm == ""  # at once: what is known is of another frame
    desk.wait(lambda: not c.penetrations)
    kept.close()
    desk.close()


@pytest.mark.slow
def test_all_objects_that_an_edit_changed_are_measured_again(
    desk: Desk, upkeep: BackgroundUpdates
) -> None:
    c = desk.controller
    pose = c.pose("box_1", 0)
    assert pose is not None
    names = ["box_1", "box_2", "box_3"]
    for i, name in enumerate(names[1:], 1):
        c.apply(AddObject(object=name, model="box"))
        beside = SE3(pose.R, pose.t + np.array([0.08 * i, 0.0, 0.0]))
        c.apply(SetPoses.one(name, 0, beside, method="typed"))
    c.apply(AddObject(object="unplaced", model="box"))
    desk.wait(lambda: set(c.residuals) == set(names))
    # As refining all does: the poses of all in one edit.
    poses = {n: c.pose(n, 0) for n in names}
    changes = [
        PoseChange(object=n, frame=0, T_cam_obj=(T @ SE3.exp([1e-3, 0, 0, 0, 0, 0])).flat())
        for n, T in poses.items()
        if T is not None
    ]
    first = len(desk.events)
    c.apply(SetPoses(changes=changes, label="Refine all"))
    assert c.residuals == {}
    desk.wait(lambda: set(c.residuals) == set(names))
    told = [e.objects for e in desk.events[first:] if e.kind == "residuals"]
    assert told[0] == ("box_1",)  # the selected one comes first
    assert sorted(n for group in told[1:] for n in group) == ["box_2", "box_3"]
    assert all(len(rows) == 3 for rows in c.residuals.values())
    assert c.unmeasured == {"unplaced"}


@pytest.mark.slow
def test_what_a_drag_held_up_is_measured_afterwards(desk: Desk, upkeep: BackgroundUpdates) -> None:
    c = desk.controller
    pose = c.pose("box_1", 0)
    assert pose is not None
    c.apply(AddObject(object="box_2", model="box"))
    beside = SE3(pose.R, pose.t + np.array([0.08, 0.0, 0.0]))
    c.apply(SetPoses.one("box_2", 0, beside, method="typed"))
    c.drag_to("box_1", 0, pose)  # cancels what that edit has asked for
    c.end_drag()
    desk.wait(lambda: set(c.residuals) == {"box_1", "box_2"})


@pytest.mark.slow
def test_ranks_that_are_not_known_yet_are_asked_for_again(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of the others are asked for while the selected object is ranked, and take its place."""
    asked: list[list[str]] = []
    monkeypatch.setattr(pose_checks, "rank_objects_aside", lambda _, names: asked.append(names))
    c = desk.controller
    pose = c.pose("box_1", 0)
    assert pose is not None
    c.apply(AddObject(object="a_box", model="box"))
    beside = SE3(pose.R, pose.t + np.array([0.08, 0.0, 0.0]))
    c.apply(SetPoses.one("a_box", 0, beside, method="typed"))
    c.select("box_1")
    operations.measure_residuals(c)
    desk.wait(lambda: len(asked) == 2)
    assert asked == [["box_1"], ["box_1", "a_box"]]
