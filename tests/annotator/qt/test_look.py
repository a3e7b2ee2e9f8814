"""Theme and text size of the window, its list of commands, and names for assistive technology."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from bench import Bench
from PySide6 import QtWidgets
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QAccessible, QColor
from PySide6.QtTest import QTest

from annotator.app.palette import DARK, LIGHT
from annotator.qt import theme
from annotator.qt.command_list import CommandList
from annotator.qt.qt_app import make_application

OpenBench = Callable[..., Bench]
CONTROL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier


@pytest.fixture(autouse=True)
def usual_look() -> Iterator[None]:
    """The next test has the usual look again."""
    yield
    theme.apply_theme(make_application())


def _share(bench: Bench, widget: QtWidgets.QWidget, color: str) -> float:
    """Share of the pixels of a widget that have a colour."""
    wanted = QColor(color)
    rgb = (wanted.red(), wanted.green(), wanted.blue())
    return float((bench.picture(widget) == rgb).all(axis=2).mean())


def test_the_theme_changes_at_once_and_back(bench: Bench) -> None:
    space, light = bench.space, bench.space.commands.actions["light_theme"]
    parts = {space.toolbar: "window", space.objects.list: "base", space.status: "window"}
    bench.qtbot.waitUntil(lambda: len(space.evidence.rows) > 1, timeout=60_000)
    bench.settle()
    before = {part: bench.picture(part) for part in parts}
    refine = space.commands.actions["refine"]
    dark_icon = refine.icon().pixmap(24, 24).toImage()
    light.trigger()
    bench.settle()
    for part, surface in parts.items():
        assert _share(bench, part, getattr(LIGHT, surface)) > 0.3, part
        assert _share(bench, part, getattr(DARK, surface)) < 0.01, part
    # Icons follow, those that widgets hold and those of the actions.
    assert refine.icon().pixmap(24, 24).toImage() != dark_icon
    inked = refine.icon().pixmap(24, 24).toImage().pixelColor(12, 4)
    assert inked.name() == LIGHT.text
    bench.qtbot.waitUntil(light.isChecked)
    light.trigger()
    bench.settle()
    for part, picture in before.items():
        np.testing.assert_array_equal(bench.picture(part), picture)


def test_images_keep_their_dark_background(bench: Bench) -> None:
    before = bench.picture(bench.widget()).mean()
    bench.controller.ask("light_theme")
    bench.settle()
    margin = bench.widget().grab().toImage().pixelColor(bench.widget().width() // 2, 3)
    assert margin.lightness() < 60
    assert abs(bench.picture(bench.widget()).mean() - before) < 3


def test_the_look_is_remembered(open_bench: OpenBench, root: object) -> None:
    bench = open_bench(root)
    bench.controller.ask("light_theme")
    bench.press(Qt.Key.Key_Plus, CONTROL)
    assert theme.look.text == 110
    bench.leave()
    theme.apply_theme(make_application())
    theme.look.apply(make_application(), light=False, text=100)
    again = open_bench(root)
    assert theme.look.light
    assert theme.look.text == 110
    assert again.controller.light


def test_a_broken_memory_of_the_look_is_the_usual_one(tmp_path: object) -> None:
    from annotator.qt import settings

    file = settings.recent_file().with_name("window.json")
    file.parent.mkdir(parents=True, exist_ok=True)
    for text in ('{"theme": 3, "text": "x"}', "[]", "{", '{"theme": "pink", "text": "-20"}'):
        file.write_text(text)
        assert settings.remembered_look() == (False, 100)
    file.write_text('{"theme": "light", "text": "900"}')
    assert settings.remembered_look() == (True, 150)


def test_at_130_percent_everything_fits_into_1366_by_768(bench: Bench) -> None:
    bench.shell.resize(1366, 768)
    line = bench.space.fontMetrics().height()
    for _ in range(3):
        bench.press(Qt.Key.Key_Plus, CONTROL)
    bench.settle()
    space = bench.space
    # The card is at its highest with the verdict.
    bench.qtbot.waitUntil(lambda: space.evidence.word.text() == "fits", timeout=60_000)
    bench.settle()
    assert space.fontMetrics().height() > 1.2 * line
    assert (bench.shell.width(), bench.shell.height()) == (1366, 768)
    fields = [*space.pose.position, *space.pose.rotation]
    for part in (
        space.toolbar, space.objects.list, space.evidence.reason, space.pose.copy_button,
        space.frame_bar.strip, space.status.saved, *fields,
        *(tile.view for tile in space.views.tiles),
    ):  # fmt: skip
        assert part.isVisible()
        corner = part.mapTo(bench.shell, QPoint(part.width() - 1, part.height() - 1))
        assert bench.shell.rect().contains(corner), part
    # No line of text is cut off.
    for field in (*fields, space.status.saved, space.evidence.name, space.pose.copy_button):
        assert field.height() >= field.fontMetrics().height(), field
    assert bench.widget().width() > 0.45 * bench.shell.width()
    bench.press(Qt.Key.Key_Minus, CONTROL)
    assert theme.look.text == 120


# --- the list of commands -------------------------------------------------------------------------


def _typed(bench: Bench, typed: str, *keys: Qt.Key) -> CommandList:
    """Open the list by its keys, type, press keys; returns the closed dialog."""
    seen: list[CommandList] = []

    def act(dialog: QtWidgets.QDialog) -> None:
        assert isinstance(dialog, CommandList)
        seen.append(dialog)
        bench.qtbot.waitUntil(dialog.search.hasFocus)
        QTest.keyClicks(dialog.search, typed)
        for key in keys:
            QTest.keyClick(dialog.search, key)
        if dialog.isVisible():
            dialog.reject()

    bench.in_dialog(act)
    # There is no window manager to give the focus back after a dialog.
    bench.shell.activateWindow()
    bench.qtbot.waitUntil(bench.shell.isActiveWindow)
    bench.space.focus_views()
    bench.press("p", CONTROL | SHIFT)
    assert seen, "no list"
    return seen[0]


def test_a_command_is_found_and_run_by_keys_alone(bench: Bench) -> None:
    before = bench.pose()
    dialog = _typed(bench, "move le", Qt.Key.Key_Return)
    assert dialog.chosen is not None
    assert dialog.chosen.target == "left"
    np.testing.assert_allclose(bench.pose().t - before.t, [-0.001, 0, 0], atol=1e-12)
    # Nothing that was typed has reached the views.
    assert len(bench.session.steps) == 1


def test_objects_and_frames_are_reached_with_the_arrows(bench: Bench) -> None:
    _typed(bench, "select", Qt.Key.Key_Return)
    assert bench.controller.selected == "ball_1"
    _typed(bench, "select", Qt.Key.Key_Down, Qt.Key.Key_Up, Qt.Key.Key_Return)
    assert bench.controller.selected == "box_1"
    _typed(bench, "frame 4", Qt.Key.Key_Return)
    assert bench.controller.frame == 4


def test_what_cannot_be_run_says_why_and_stays(bench: Bench) -> None:
    dialog = _typed(bench, "undo", Qt.Key.Key_Return)
    assert dialog.chosen is None
    assert dialog.tip.text() == "Not now: there is no edit to take back."
    dialog = _typed(bench, "xyzzy", Qt.Key.Key_Return)
    assert dialog.rows == []
    assert dialog.tip.text() == "Nothing has this name."


# --- assistive technology -------------------------------------------------------------------------


def _nameless(root: QtWidgets.QWidget) -> list[str]:
    """Controls without a name, as a screen reader asks for it."""
    controls = (
        QtWidgets.QAbstractButton, QtWidgets.QLineEdit, QtWidgets.QPlainTextEdit,
        QtWidgets.QAbstractSpinBox, QtWidgets.QComboBox, QtWidgets.QAbstractSlider,
        QtWidgets.QAbstractItemView, QtWidgets.QProgressBar,
    )  # fmt: skip
    inner = (
        QtWidgets.QAbstractSpinBox, QtWidgets.QComboBox, QtWidgets.QScrollBar,
        QtWidgets.QHeaderView, QtWidgets.QTabBar, QtWidgets.QLineEdit,
    )  # fmt: skip
    found = []
    for widget in root.findChildren(QtWidgets.QWidget):
        parent = widget.parent()
        if isinstance(widget, QtWidgets.QScrollBar | QtWidgets.QHeaderView):
            continue
        if isinstance(parent, inner) or not isinstance(widget, controls):
            continue  # a part of a control that has a name
        if widget.objectName().startswith("qt_") or "QComboBox" in str(
            parent and parent.metaObject().className()
        ):
            continue  # made by Qt
        one = QAccessible.queryAccessibleInterface(widget)
        if not one.text(QAccessible.Text.Name).strip():
            found.append(
                f"{type(widget).__name__} {widget.objectName()} in {type(parent).__name__}"
            )
    return found


def test_every_button_and_field_has_a_name(bench: Bench) -> None:
    bench.controller.tell("A message.", "warning")
    bench.settle()
    assert _nameless(bench.shell) == []
    bench.space.pose.copy_button.setText("")
    assert len(_nameless(bench.shell)) == 1
    for name in ("rename", "note", "symmetry", "propagate", "commands"):
        missing: list[str] = []

        def look(dialog: QtWidgets.QDialog, missing: list[str] = missing) -> None:
            missing += _nameless(dialog)
            dialog.reject()

        bench.in_dialog(look)
        bench.controller.ask(name)
        assert missing == [], name
