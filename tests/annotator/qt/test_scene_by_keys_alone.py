"""A scene labelled in the window without a mouse: place, move, type, refine, note, done, leave."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from bench import Bench
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog
from window_scene import T_WORLD_BOX, write_window_scene

from std_toolkit.scene import Scene

Key = Qt.Key
CONTROL = Qt.KeyboardModifier.ControlModifier


def keys(bench: Bench, *pressed: Key, typed: str = "") -> None:
    """Type into the next dialog where it has the focus, and press keys there."""

    def act(dialog: QDialog) -> None:
        bench.qtbot.waitUntil(lambda: dialog.focusWidget() is not None)
        QTest.keyClicks(dialog.focusWidget(), typed)
        for key in pressed:
            QTest.keyClick(dialog.focusWidget() or dialog, key)

    bench.in_dialog(act)


def back(bench: Bench) -> None:
    """There is no window manager to give the focus back after a dialog."""
    bench.shell.activateWindow()
    bench.qtbot.waitUntil(bench.shell.isActiveWindow)
    bench.space.focus_views()


def test_one_scene_is_labelled_by_keys_alone(
    open_bench: Callable[..., Bench], tmp_path: Path
) -> None:
    root = write_window_scene(tmp_path / "scene", labelled=False)
    bench = open_bench(root)
    c, space = bench.controller, bench.space

    keys(bench, Key.Key_Return, typed="Place box")
    bench.press("k", CONTROL)
    back(bench)
    bench.qtbot.waitUntil(lambda: c.session.pose("box_1", 0) is not None)
    assert c.selected == "box_1"

    # Through the fields of the panels and back to the views; what is typed counts.
    truth = T_WORLD_BOX
    seen = []
    for _ in range(12):
        bench.press(Key.Key_F6)
        field = QApplication.focusWidget()
        if field is bench.widget():
            break
        seen.append(field)
        place = next((k for k, f in enumerate(space.pose.position) if f is field), None)
        if place is not None:
            field.selectAll()
            QTest.keyClicks(field, f"{1000 * truth.t[place] + (2, -1, 3)[place]:.2f}")
            bench.press(Key.Key_Return, on=field)
    numbers = [*space.pose.position, *space.pose.rotation]
    assert [field for field in seen if field in numbers] == numbers
    assert QApplication.focusWidget() is bench.widget()
    np.testing.assert_allclose(bench.pose().t - truth.t, [0.002, -0.001, 0.003], atol=1e-5)
    bench.press(Key.Key_F6)
    bench.press(Key.Key_Escape)
    assert QApplication.focusWidget() is bench.widget()
    before = bench.pose()
    bench.press(Key.Key_Left)
    np.testing.assert_allclose(bench.pose().t - before.t, [-0.001, 0, 0], atol=1e-12)

    moved = bench.pose()
    bench.press("r")
    bench.qtbot.waitUntil(lambda: c.task is None, timeout=60_000)
    assert np.abs(bench.pose().t - moved.t).max() > 1e-4
    keys(bench, Key.Key_Tab, Key.Key_Return, typed="by keys")
    bench.press(Key.Key_F3)
    back(bench)
    assert bench.session.object("box_1").note == "by keys"
    bench.press("d")
    bench.qtbot.waitUntil(lambda: bench.session.object("box_1").status == "done", timeout=60_000)
    bench.press("s", CONTROL)
    bench.qtbot.waitUntil(lambda: not bench.session.unsaved)
    label = Scene.open(root).labels.labels[0]
    assert np.abs(np.reshape(label.T_cam_obj, (4, 4))[:3, 3] - truth.t).max() < 0.005
