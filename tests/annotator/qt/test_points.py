"""Clicked 2D-3D correspondences give a pose, and can be corrected."""

from __future__ import annotations

import numpy as np
import pytest
from bench import Bench
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest

from annotator.app.view_options import Gizmo
from annotator.session import SetPoses
from std_toolkit.geometry import SE3, rotation_angle

Key = Qt.Key
HALF = np.array([0.05, 0.035, 0.07])


def _visible(bench: Bench, pose: SE3) -> list[np.ndarray]:
    """Points of the box that are seen at a pose, spread over all faces that look to the camera."""
    view, seen = bench.view(), []
    for face in range(6):
        for a, b in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
            point = np.zeros(3)
            point[face % 3] = 1.0 if face < 3 else -1.0
            point[[(face + 1) % 3, (face + 2) % 3]] = a, b
            point *= HALF
            hit = view.objects.pick_on(view, "box_1", view.screen.project(pose @ point))
            if hit is not None and np.linalg.norm(hit - point) < 0.002:
                seen.append(point)
    return seen


def _click_points(bench: Bench, wanted: SE3) -> int:
    """Click points on the mesh where it is, then where `wanted` would put them."""
    view, pose = bench.view(), bench.pose()
    count = 0
    for point in _visible(bench, pose):
        x, y = view.screen.project(pose @ point)
        clicks = bench.session.object("box_1").clicks.get(0, [])
        crosses = view.screen_of_recorded(np.array([[c.u, c.v] for c in clicks]).reshape(-1, 2))
        # A press near a cross would take it, on the mesh and in the image.
        uv = view.recorded_camera.project(wanted @ point[None])
        spots = [(x, y), view.screen_of_recorded(uv)]
        if len(crosses) and any(np.linalg.norm(crosses - s, axis=1).min() < 15 for s in spots):
            continue
        bench.click(QPoint(int(x), int(y)))
        assert bench.controller.pending_point is not None
        hit = np.array(bench.controller.pending_point)
        uv = view.recorded_camera.project(wanted @ hit)
        bench.click(bench.at(uv))
        assert bench.controller.pending_point is None
        count += 1
    return count


def test_points_clicked_on_mesh_and_image_give_the_pose(bench: Bench) -> None:
    start = bench.pose()
    wanted = SE3(start.R, start.t + np.array([0.02, -0.015, 0.03])) @ SE3.exp(
        [0, 0, 0, 0.1, -0.15, 0.05]
    )
    bench.controller.set_tool(gizmo=Gizmo.OFF)
    bench.settle()
    bench.press("c")
    assert bench.space.tabs.currentWidget() is bench.space.points
    bench.qtbot.waitUntil(lambda: "Four points to go" in bench.space.status.hint.text())
    bench.settle()
    count = _click_points(bench, wanted)
    assert count >= 6
    panel = bench.space.points
    assert panel.table.rowCount() == count
    assert max(r.residual_px or 0 for r in panel.rows) > 5
    steps = len(bench.session.steps)
    bench.press(Key.Key_Return)
    bench.qtbot.waitUntil(lambda: bench.controller.task is None, timeout=10_000)
    found = bench.pose()
    assert np.linalg.norm(found.t - wanted.t) < 0.004
    assert np.degrees(rotation_angle(found.R @ wanted.R.T)) < 1.5
    assert len(bench.session.steps) == steps + 1
    assert max(r.residual_px or 9 for r in panel.rows) < 0.6
    assert "points fit" in bench.message()
    bench.press("z", Qt.KeyboardModifier.ControlModifier)
    assert bench.pose().flat() == start.flat()


def test_too_few_points_are_a_message(bench: Bench) -> None:
    bench.press("c")
    bench.press(Key.Key_Return)
    bench.qtbot.waitUntil(lambda: "at least 4" in bench.message(), timeout=10_000)


def test_a_point_is_corrected_by_hand_or_number_and_deleted(bench: Bench) -> None:
    bench.controller.set_tool(gizmo=Gizmo.OFF)
    bench.press("c")
    bench.settle()
    _click_points(bench, bench.pose())
    clicks = bench.session.object("box_1").clicks[0]
    # Drag the cross of the second point.
    before = clicks[1]
    bench.drag(bench.at((before.u, before.v)), QPoint(24, 0))
    moved = bench.session.object("box_1").clicks[0][1]
    assert moved.u - before.u == pytest.approx(24 / bench.view().screen.fx * 300.0, abs=0.6)
    assert moved.point == before.point
    # Type the column of the third one.
    item = bench.space.points.table.item(2, 2)
    item.setText("123.5")
    assert bench.session.object("box_1").clicks[0][2].u == 123.5
    bench.space.points.table.item(2, 3).setText("abc")
    assert "not a pixel" in bench.message()
    # Delete the first one.
    bench.space.points.table.selectRow(0)
    QTest.mouseClick(bench.space.points.remove_button, Qt.MouseButton.LeftButton)
    left = bench.session.object("box_1").clicks[0]
    assert len(left) == len(clicks) - 1
    assert left[0].point == clicks[1].point


def test_a_point_is_taken_from_the_mesh_by_itself_for_an_object_without_a_pose(
    bench: Bench,
) -> None:
    bench.press("n")
    bench.press("c")
    picker = bench.space.points.picker
    bench.qtbot.waitUntil(lambda: picker.widget is not None and picker.widget.isVisible())
    bench.qtbot.waitUntil(lambda: picker.view._solid is not None, timeout=10_000)
    bench.qtbot.wait(100)
    middle = picker.widget.rect().center()
    QTest.mouseClick(picker.widget, Qt.MouseButton.LeftButton, pos=middle)
    point = bench.controller.pending_point
    assert point is not None
    # The ball is 35 mm in radius.
    assert np.linalg.norm(point) == pytest.approx(0.035, rel=0.01)
    bench.click(bench.at((80, 100)))
    (click,) = bench.session.object("ball_1").clicks[0]
    assert (click.u, click.v) == pytest.approx((80, 100), abs=0.5)
    assert click.point == pytest.approx(list(point))


def test_escape_takes_another_point(bench: Bench) -> None:
    bench.controller.set_tool(gizmo=Gizmo.OFF)
    bench.press("c")
    bench.settle()
    bench.click(bench.on_object())
    assert bench.controller.pending_point is not None
    bench.press(Key.Key_Escape)
    assert bench.controller.pending_point is None
    assert bench.session.object("box_1").clicks == {}


def test_clicks_of_another_frame_stay_with_it(bench: Bench) -> None:
    c = bench.controller
    c.apply(SetPoses.one("box_1", 0, bench.pose(), method="typed"))
    bench.press("c")
    bench.press(Key.Key_Right, Qt.KeyboardModifier.ControlModifier)
    bench.settle()
    _count = len(bench.session.steps)
    view = bench.view()
    x, y = view.screen.project(bench.pose(frame=1) @ np.array([0, 0, -0.07]))
    bench.click(QPoint(int(x), int(y)))
    bench.click(bench.at((60, 60)))
    assert list(bench.session.object("box_1").clicks) == [1]
    assert len(bench.session.steps) == _count + 1
