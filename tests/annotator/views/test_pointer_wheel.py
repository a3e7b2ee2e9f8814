"""The wheel with a key moves the selected object: a turn of it is one edit."""

from __future__ import annotations

import numpy as np
import pytest
from views_desk import Desk, edits

from annotator.app.action_table import BY_ID
from std_toolkit.geometry import so3_log


def test_wheel_with_ctrl_moves_along_the_line_of_sight(desk: Desk) -> None:
    desk.controller.select("ring_1")
    before = desk.pose()
    for _ in range(3):
        desk.event("MouseWheelForward", (300, 200), ctrl=True)
    assert edits(desk) == []  # it may go on
    desk.settle()
    shift = desk.pose().t - before.t
    assert len(edits(desk)) == 1
    sight = before.t / np.linalg.norm(before.t)
    assert shift == pytest.approx(0.003 * sight, abs=1e-9)
    # Seen from here it stays in its place.
    screen = desk.main.screen
    assert screen.project(desk.pose().t) == pytest.approx(screen.project(before.t), abs=1e-6)


def test_wheel_with_shift_turns_on_the_table(desk: Desk) -> None:
    desk.controller.select("ring_1")
    before = desk.pose()
    for _ in range(3):
        desk.event("MouseWheelForward", (300, 200), shift=True)
    desk.settle()
    assert len(edits(desk)) == 1
    turn = so3_log(desk.pose().R @ before.R.T)
    up = desk.controller.up(desk.controller.active_frame)
    assert np.rad2deg(turn) == pytest.approx(3 * up, abs=1e-6)


def test_a_press_ends_the_turn_of_the_wheel(desk: Desk) -> None:
    desk.controller.select("ring_1")
    desk.event("MouseWheelForward", (300, 200), ctrl=True)
    desk.event("LeftButtonPress", (5, 470))
    assert len(edits(desk)) == 1
    desk.event("LeftButtonRelease", (5, 470))
    desk.settle()
    assert len(edits(desk)) == 1


def test_undo_right_after_the_wheel_takes_back_what_the_wheel_did(desk: Desk) -> None:
    desk.controller.select("ring_1")
    desk.controller.nudge(shift=(5, 0, 0))
    placed = desk.pose().matrix()
    desk.event("MouseWheelForward", (300, 200), ctrl=True)
    moved = desk.main.T_eye_obj("ring_1")
    assert moved is not None and (moved.matrix() != placed).any()
    desk.controller.undo()  # within the pause that ends a turn of the wheel
    assert (desk.pose().matrix() == placed).all()
    desk.settle()
    assert (desk.pose().matrix() == placed).all()
    desk.controller.redo()
    assert desk.pose().matrix() == pytest.approx(moved.matrix(), abs=1e-12)


def test_the_wheel_can_be_undone_before_anything_else_was_edited(desk: Desk) -> None:
    undo = BY_ID["undo"]
    desk.controller.select("ring_1")
    assert not undo.enabled(desk.controller)
    desk.event("MouseWheelForward", (300, 200), ctrl=True)
    assert undo.enabled(desk.controller)
    before = desk.pose().matrix()
    undo.run(desk.controller)
    assert (desk.pose().matrix() == before).all()
    assert desk.controller.dragging is None


def test_redo_right_after_the_wheel_keeps_what_the_wheel_did(desk: Desk) -> None:
    desk.controller.select("ring_1")
    desk.controller.nudge(shift=(5, 0, 0))
    desk.controller.undo()
    desk.event("MouseWheelForward", (300, 200), ctrl=True)
    moved = desk.main.T_eye_obj("ring_1")
    desk.controller.redo()
    desk.settle()
    assert moved is not None
    assert desk.pose().matrix() == pytest.approx(moved.matrix(), abs=1e-12)
    assert desk.messages() == []


def test_a_press_in_another_view_ends_it_too(desk: Desk) -> None:
    desk.controller.select("ring_1")
    desk.event("MouseWheelForward", (300, 200), ctrl=True)
    start = desk.on("ring_1", view=1)
    desk.event("LeftButtonPress", start, view=1)
    assert len(edits(desk)) == 1
    desk.event("MouseMove", start + np.array([15, 0]), view=1)
    desk.clock.pass_(2.0)  # longer than a pause of the wheel
    assert desk.controller.dragging == "ring_1"
    desk.event("LeftButtonRelease", start + np.array([15, 0]), view=1)
    assert len(edits(desk)) == 2
