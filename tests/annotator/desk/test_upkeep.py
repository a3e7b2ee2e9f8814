"""Table, penetration and residuals follow the edits by themselves."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from desk_without_window import Desk
from scene_on_disk import camera_pose, camera_poses, write_scene

from annotator.desk.upkeep import Upkeep
from annotator.session import AddObject, Move, SetPoses
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene").root)
    made.controller.select("box_1")
    yield made
    made.close()


@pytest.fixture
def upkeep(desk: Desk) -> Iterator[Upkeep]:
    made = Upkeep(desk.controller)
    yield made
    made.close()


def measured(desk: Desk) -> bool:
    return "box_1" in desk.controller.residuals


def test_what_is_known_of_a_scene_comes_by_itself(desk: Desk, upkeep: Upkeep) -> None:
    desk.wait(lambda: measured(desk) and desk.controller.table is not None)
    assert [row.frame for row in desk.controller.residuals["box_1"]] == [0, 1, 2]
    table = desk.controller.table
    assert table is not None
    assert table.plane.signed_distance([0.0, 0.0, 0.8]) == pytest.approx(0, abs=0.01)


def test_residuals_of_an_object_that_moved_are_gone_at_once(desk: Desk, upkeep: Upkeep) -> None:
    desk.wait(lambda: measured(desk))
    desk.controller.nudge(shift=(1, 0, 0))
    assert not measured(desk)
    desk.wait(lambda: measured(desk))


def test_another_object_does_not_take_them_away(desk: Desk, upkeep: Upkeep) -> None:
    desk.wait(lambda: measured(desk))
    desk.controller.apply(AddObject(object="box_2", model="box"))
    assert measured(desk)


def test_a_drag_that_is_given_up_lets_the_work_go_on(desk: Desk, upkeep: Upkeep) -> None:
    controller = desk.controller
    pose = controller.pose("box_1", 0)
    assert pose is not None
    controller.nudge(shift=(1, 0, 0))
    controller.drag_to("box_1", 0, pose)  # cancels what the nudge has asked for
    desk.rest(1.5)
    assert not measured(desk)
    controller.cancel()
    desk.wait(lambda: measured(desk))


def test_objects_in_one_place_are_told_and_told_again_when_they_part(
    desk: Desk, upkeep: Upkeep
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


def test_in_another_world_the_table_is_looked_for_again(desk: Desk, upkeep: Upkeep) -> None:
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
