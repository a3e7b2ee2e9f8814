"""Keys of the window move the selected object, wherever the focus is, and nothing else does."""

from __future__ import annotations

import numpy as np
import pytest
from bench import Bench
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from std_toolkit.geometry import SE3, so3_exp

Key = Qt.Key
SHIFT, CONTROL = Qt.KeyboardModifier.ShiftModifier, Qt.KeyboardModifier.ControlModifier


@pytest.mark.parametrize(
    ("key", "direction"),
    [
        (Key.Key_Left, (-1, 0, 0)),
        (Key.Key_Right, (1, 0, 0)),
        (Key.Key_Up, (0, -1, 0)),
        (Key.Key_Down, (0, 1, 0)),
        (Key.Key_PageUp, (0, 0, 1)),
        (Key.Key_PageDown, (0, 0, -1)),
    ],
)
def test_arrows_shift_by_a_millimetre_along_the_camera(
    bench: Bench, key: Key, direction: tuple[int, int, int]
) -> None:
    before = bench.pose()
    bench.press(key)
    after = bench.pose()
    np.testing.assert_allclose(after.t - before.t, 0.001 * np.array(direction), atol=1e-12)
    np.testing.assert_array_equal(after.R, before.R)


@pytest.mark.parametrize(("key", "sign"), [(Key.Key_Right, 1), (Key.Key_Left, -1)])
def test_shift_and_arrows_turn_by_a_degree_on_the_table(bench: Bench, key: Key, sign: int) -> None:
    bench.qtbot.waitUntil(lambda: bench.controller.table is not None, timeout=20_000)
    before = bench.pose()
    bench.press(key, SHIFT)
    after = bench.pose()
    up = bench.controller.up(bench.controller.active_frame)
    expected = so3_exp(sign * np.radians(1.0) * up) @ before.R
    np.testing.assert_allclose(after.R, expected, atol=1e-9)
    # The middle of the box is the origin of its mesh: it stays.
    np.testing.assert_allclose(after.t, before.t, atol=1e-12)


@pytest.mark.parametrize(("key", "step_mm"), [("7", 10.0), ("8", 1.0), ("9", 0.1)])
def test_numbers_choose_the_step(bench: Bench, key: str, step_mm: float) -> None:
    bench.press(key)
    before = bench.pose()
    bench.press(Key.Key_Right)
    np.testing.assert_allclose(bench.pose().t - before.t, [step_mm / 1000, 0, 0], atol=1e-12)


def test_steps_follow_the_axes_of_the_object_when_asked(bench: Bench) -> None:
    bench.press("a")
    before = bench.pose()
    bench.press(Key.Key_Right)
    np.testing.assert_allclose(bench.pose().t - before.t, 0.001 * before.R[:, 0], atol=1e-12)


def test_steps_are_along_the_camera_of_the_view_in_hand(bench: Bench) -> None:
    side = 2
    frame = bench.controller.view_frames[side]
    bench.click(bench.widget(side).rect().topLeft() + bench.at((10, 10), side), side)
    before = bench.pose(frame=frame)
    bench.press(Key.Key_Right)
    np.testing.assert_allclose(bench.pose(frame=frame).t - before.t, [0.001, 0, 0], atol=1e-9)


def test_a_key_held_down_moves_on(bench: Bench) -> None:
    before = bench.pose()
    bench.hold(Key.Key_Right, 4)
    np.testing.assert_allclose(bench.pose().t - before.t, [0.005, 0, 0], atol=1e-12)


def test_a_switch_held_down_switches_once(bench: Bench) -> None:
    bench.hold(Key.Key_K, 4)
    assert bench.controller.options.contour_always


def test_undo_and_redo_bring_poses_back_bit_for_bit(bench: Bench) -> None:
    poses = [bench.pose().flat()]
    for key in (Key.Key_Right, Key.Key_PageUp, Key.Key_Down):
        bench.press(key)
        bench.press(key, SHIFT)
        poses.append(bench.pose().flat())
    for pose in reversed(poses[:-1]):
        bench.press("z", CONTROL)
        bench.press("z", CONTROL)
        assert bench.pose().flat() == pose
    for pose in poses[1:]:
        bench.press("z", CONTROL | SHIFT)
        bench.press("y", CONTROL)
        assert bench.pose().flat() == pose


@pytest.mark.parametrize(("key", "axis"), [("x", 0), ("y", 1), ("z", 2)])
def test_flips_turn_half_round_and_twice_is_none(bench: Bench, key: str, axis: int) -> None:
    before = bench.pose()
    bench.press(key, SHIFT)
    half = np.zeros(3)
    half[axis] = np.pi
    np.testing.assert_allclose(bench.pose().R, before.R @ so3_exp(half), atol=1e-12)
    bench.press(key, SHIFT)
    np.testing.assert_allclose(bench.pose().matrix(), before.matrix(), atol=1e-12)


def test_keys_work_from_every_part_of_the_window(bench: Bench) -> None:
    for widget in (bench.widget(0), bench.widget(1), bench.space.objects.list, bench.space.tabs):
        before = bench.pose()
        bench.press(Key.Key_Right, on=widget)
        np.testing.assert_allclose(bench.pose().t - before.t, [0.001, 0, 0], atol=1e-12)


def test_objects_are_gone_through_and_marked_done(bench: Bench) -> None:
    assert bench.controller.selected == "box_1"
    bench.press("n")
    assert bench.controller.selected == "ball_1"
    bench.press("p")
    bench.press("d")
    # A pose that was not measured yet is measured first; one that fits raises no question.
    bench.qtbot.waitUntil(lambda: bench.session.object("box_1").status == "done", timeout=30_000)
    assert bench.questions == []
    assert bench.space.objects.count.text() == "1 of 2 done"
    bench.press("d")
    assert bench.session.object("box_1").status == "open"


# --- typing ---------------------------------------------------------------------------------------


def _field(bench: Bench, which: str, axis: int) -> object:
    field = getattr(bench.space.pose, which)[axis]
    QTest.mouseClick(field.lineEdit(), Qt.MouseButton.LeftButton)
    bench.qtbot.waitUntil(field.hasFocus)
    field.selectAll()
    return field


def test_a_typed_number_sets_the_position_and_leaves_the_rest(bench: Bench) -> None:
    before = bench.pose()
    field = _field(bench, "position", 1)
    QTest.keyClicks(field, "-12.5")  # type: ignore[arg-type]
    bench.press(Key.Key_Return, on=field)  # type: ignore[arg-type]
    after = bench.pose()
    assert after.t[1] == -0.0125
    np.testing.assert_array_equal(after.t[[0, 2]], before.t[[0, 2]])
    np.testing.assert_array_equal(after.R, before.R)
    assert bench.session.undoable is not None
    bench.press("z", CONTROL)
    assert bench.pose().flat() == before.flat()


def test_typing_moves_nothing_until_it_is_entered(bench: Bench) -> None:
    before, steps = bench.pose().flat(), len(bench.session.steps)
    field = _field(bench, "position", 0)
    for key in (*"7d1", Key.Key_Left, Key.Key_Home, Key.Key_Delete, Key.Key_Space, "r", "s"):
        bench.press(key, on=field)  # type: ignore[arg-type]
    assert bench.pose().flat() == before
    assert len(bench.session.steps) == steps
    assert bench.controller.step == 1.0
    bench.press(Key.Key_Escape, on=field)  # type: ignore[arg-type]
    assert bench.pose().flat() == before
    bench.qtbot.waitUntil(lambda: bench.widget(0).hasFocus())
    bench.press(Key.Key_Right)
    assert bench.pose().t[0] == pytest.approx(before[3] + 0.001, abs=1e-12)


def test_leaving_a_field_that_nobody_changed_rounds_nothing(bench: Bench) -> None:
    before, steps = bench.pose().flat(), len(bench.session.steps)
    for which in ("position", "rotation"):
        for axis in range(3):
            field = _field(bench, which, axis)
            bench.press(Key.Key_Return, on=field)  # type: ignore[arg-type]
    bench.space.focus_views()
    assert bench.pose().flat() == before
    assert len(bench.session.steps) == steps


def test_arrows_in_a_field_step_its_number(bench: Bench) -> None:
    before = bench.pose()
    field = _field(bench, "position", 0)
    bench.press(Key.Key_Up, on=field)  # type: ignore[arg-type]
    np.testing.assert_allclose(bench.pose().t - before.t, [0.001, 0, 0], atol=1e-12)
    # Page up outside of a field would move the object away from the camera.
    bench.press(Key.Key_PageUp, on=field)  # type: ignore[arg-type]
    np.testing.assert_allclose(bench.pose().t - before.t, [0.011, 0, 0], atol=1e-12)


def test_a_matrix_is_copied_and_pasted_in_the_world(bench: Bench) -> None:
    panel = bench.space.pose
    panel._frame_box.setCurrentIndex(1)
    T_world_obj = bench.session.T_world_obj("box_1")
    assert T_world_obj is not None
    QTest.mouseClick(panel.copy_button, Qt.MouseButton.LeftButton)
    from PySide6.QtWidgets import QApplication

    clipboard = QApplication.clipboard()
    numbers = np.array(clipboard.text().split(), float).reshape(4, 4)
    np.testing.assert_allclose(numbers, T_world_obj.matrix(), atol=1e-15)
    target = SE3(T_world_obj.R, T_world_obj.t + np.array([0.01, 0, 0]))
    clipboard.setText(f"np.array({target.matrix().tolist()})")
    QTest.mouseClick(panel.paste_button, Qt.MouseButton.LeftButton)
    pasted = bench.session.T_world_obj("box_1")
    assert pasted is not None
    np.testing.assert_allclose(pasted.matrix(), target.matrix(), atol=1e-12)


def test_pasting_words_is_a_message_and_no_edit(bench: Bench) -> None:
    from PySide6.QtWidgets import QApplication

    before = bench.pose().flat()
    QApplication.clipboard().setText("hello 1 2 3")
    bench.space.pose.paste()
    assert "hello" in bench.message()
    assert bench.pose().flat() == before


def test_a_quaternion_is_typed_as_a_whole_and_keys_reach_the_views_again(bench: Bench) -> None:
    panel = bench.space.pose
    forms = panel._form_box
    forms.setCurrentIndex(forms.findText("quaternion w x y z"))
    assert not panel.rotation[0].isVisible()
    numbers = np.array(panel.quaternion.text().split(), float)
    np.testing.assert_allclose(numbers, bench.pose().quat(), atol=1e-5)
    panel.quaternion.setFocus()
    panel.quaternion.selectAll()
    QTest.keyClicks(panel.quaternion, "0.5 0.5 0.5 0.5")
    QTest.keyClick(panel.quaternion, Key.Key_Return)
    np.testing.assert_allclose(bench.pose().R, [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    assert not panel.quaternion.hasFocus()
    before = bench.pose()
    panel.quaternion.setFocus()
    panel.quaternion.selectAll()
    QTest.keyClicks(panel.quaternion, "1 2 3")
    QTest.keyClick(panel.quaternion, Key.Key_Return)
    assert "4 numbers" in bench.message()
    assert bench.pose().flat() == before.flat()
