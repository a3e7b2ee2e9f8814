"""Objects follow the mouse in every view, and go back when asked."""

from __future__ import annotations

import numpy as np
import pytest
from bench import Bench
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest

from annotator.app.events import Event
from annotator.app.view_options import Gizmo

CONTROL = Qt.KeyboardModifier.ControlModifier


@pytest.fixture
def free(bench: Bench) -> Bench:
    """Without handles: a drag takes the object itself."""
    bench.controller.set_tool(gizmo=Gizmo.OFF)
    bench.settle()
    return bench


@pytest.mark.parametrize("slot", [0, 2])
def test_a_drag_keeps_the_point_that_was_taken_under_the_pointer(free: Bench, slot: int) -> None:
    view, frame = free.view(slot), free.controller.view_frames[slot]
    before = free.pose(frame=frame)
    start, by = free.on_object(slot=slot), QPoint(30, -12)
    pixel = np.array([start.x() + 0.5, start.y() + 0.5])
    point = view.objects.pick_on(view, "box_1", pixel)
    assert point is not None
    free.drag(start, by, slot)
    after = free.pose(frame=frame)
    expected = pixel + np.array([by.x(), by.y()])
    np.testing.assert_allclose(view.screen.project(after @ point), expected, atol=0.01)
    assert (after @ point)[2] == pytest.approx((before @ point)[2], abs=1e-9)
    np.testing.assert_allclose(after.R, before.R, atol=1e-12)


def test_a_drag_is_one_edit_that_undo_takes_back_bit_for_bit(free: Bench) -> None:
    before, steps = free.pose().flat(), len(free.session.steps)
    free.drag(free.on_object(), QPoint(40, 25))
    moved = free.pose().flat()
    assert moved != before
    assert len(free.session.steps) == steps + 1
    free.press("z", CONTROL)
    assert free.pose().flat() == before
    free.press("y", CONTROL)
    assert free.pose().flat() == moved


def test_the_other_views_follow_a_drag(free: Bench) -> None:
    frame = free.controller.view_frames[3]
    before = free.pose(frame=frame)
    free.drag(free.on_object(), QPoint(40, 0))
    after = free.pose(frame=frame)
    T_a_b = free.session.T_world_cam(frame).inverse() @ free.session.T_world_cam(0)  # type: ignore[union-attr]
    shift = free.pose(frame=0).t - (T_a_b.inverse() @ before).t
    np.testing.assert_allclose(after.t - before.t, T_a_b.R @ shift, atol=1e-9)


def test_escape_puts_back_what_is_being_dragged(free: Bench) -> None:
    before = free.pose().flat()
    start = free.on_object()
    free.drag(start, QPoint(50, 30), drop=False)
    assert free.controller.dragging == "box_1"
    assert free.controller.pose("box_1", 0).flat() != before  # type: ignore[union-attr]
    free.press(Qt.Key.Key_Escape)
    assert free.controller.dragging is None
    QTest.mouseRelease(free.widget(), Qt.MouseButton.LeftButton, pos=start + QPoint(50, 30))
    free.settle()
    assert free.pose().flat() == before
    assert not free.session.steps


def test_the_handle_along_x_moves_along_x_only(bench: Bench) -> None:
    bench.controller.set_tool(gizmo=Gizmo.MOVE)
    bench.settle()
    view = bench.view()
    frame = view.gizmo_frame()
    handle = next(h for h in frame.handles(Gizmo.MOVE) if h.axis == 0)
    tip = frame.line(handle)[-1]
    before = bench.pose()
    bench.drag(QPoint(int(tip[0]), int(tip[1])), QPoint(36, 10))
    moved = bench.pose().t - before.t
    assert moved[0] > 0.005
    np.testing.assert_allclose(moved[1:], 0, atol=1e-9)
    np.testing.assert_allclose(bench.pose().R, before.R, atol=1e-12)


def test_shift_drag_turns_the_object_about_its_middle(free: Bench) -> None:
    before = free.pose()
    shift = Qt.KeyboardModifier.ShiftModifier
    free.drag(free.on_object(), QPoint(40, 0), modifiers=shift)
    after = free.pose()
    assert np.abs(after.R - before.R).max() > 0.1
    np.testing.assert_allclose(after.t, before.t, atol=1e-9)


def test_a_click_selects_and_an_empty_place_moves_the_image(free: Bench) -> None:
    free.controller.select("ball_1")
    free.click(free.on_object("box_1"))
    assert free.controller.selected == "box_1"
    before = free.view().screen_of_recorded(np.array([[20.0, 20.0]]))[0]
    free.drag(free.at((20, 200)), QPoint(25, -15))
    after = free.view().screen_of_recorded(np.array([[20.0, 20.0]]))[0]
    np.testing.assert_allclose(after - before, [25, -15], atol=1.0)
    assert not free.session.steps


def test_double_click_brings_a_side_view_into_the_main_one(bench: Bench) -> None:
    frames = list(bench.controller.view_frames)
    place = bench.at((10, 200), 1)
    QTest.mouseClick(bench.widget(1), Qt.MouseButton.LeftButton, pos=place)
    QTest.mouseDClick(bench.widget(1), Qt.MouseButton.LeftButton, pos=place)
    assert bench.controller.view_frames == [frames[1], frames[0], *frames[2:]]


def test_a_double_click_leaves_the_mouse_as_it_is(free: Bench) -> None:
    """pyvista toggles charts by it, and would turn the camera from then on."""
    place = free.on_object()
    for _ in range(2):
        QTest.mouseClick(free.widget(), Qt.MouseButton.LeftButton, pos=place)
    before = free.pose()
    free.drag(place, QPoint(30, 0))
    assert free.pose().t[0] > before.t[0]
    assert free.controller.dragging is None
    np.testing.assert_allclose(free.pose().R, before.R, atol=1e-12)


def test_the_picture_shows_the_object_where_its_pose_puts_it(free: Bench) -> None:
    """Its colour is around its projected middle, and the grey image everywhere else."""
    free.controller.select("ball_1")
    free.controller.set_options(opacity=1.0)
    free.settle()
    place, far = free.on_object("box_1"), free.at((30, 200))
    picture = free.picture(free.widget()).astype(int)

    def saturation(at: QPoint) -> float:
        part = picture[at.y() - 4 : at.y() + 5, at.x() - 4 : at.x() + 5].reshape(-1, 3)
        return float((part.max(axis=1) - part.min(axis=1)).mean())

    assert saturation(place) > 30
    assert saturation(far) < 3
    free.controller.set_options(hidden=True)
    free.settle()
    picture = free.picture(free.widget()).astype(int)
    assert saturation(place) < 3


@pytest.mark.parametrize("slot", [0, 1])
def test_the_widget_shows_what_its_view_draws(bench: Bench, slot: int) -> None:
    """Also after zooming, and with the window drawn over and over."""
    view, widget = bench.view(slot), bench.widget(slot)
    bench.controller.emit(Event("look", text="object"))
    bench.settle()
    shown = bench.picture(widget).astype(int)
    drawn = view.screenshot().astype(int)
    assert shown.shape == drawn.shape
    # The buttons in the corner lie over it.
    corner = bench.space.views.tiles[slot].corner.geometry()
    shown[: corner.bottom() + 1, corner.left() :] = 0
    drawn[: corner.bottom() + 1, corner.left() :] = 0
    assert np.abs(shown - drawn).mean() < 0.5
    assert drawn.std() > 5
