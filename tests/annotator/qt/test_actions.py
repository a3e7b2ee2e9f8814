"""Everything that can be done stands in the menus, with a key of its own and a tip."""

from __future__ import annotations

from collections import Counter

from bench import Bench
from PySide6.QtCore import Qt
from PySide6.QtGui import QAction, QKeySequence

from annotator.app.action_table import ACTIONS, BY_ID, MENUS, SHORT_TITLES, TOOLS
from annotator.qt.question_dialog import QuestionDialog


def test_every_action_stands_in_its_menu_once(bench: Bench) -> None:
    bar = bench.shell.menuBar()
    assert [action.text() for action in bar.actions()] == list(MENUS)
    shown: dict[str, list[QAction]] = {name: [] for name in MENUS}
    for name, menu in bench.space.commands.menus.items():
        own = [a for a in menu.actions() if a.isVisible() and a in bench.shell.actions()]
        shown[name.split("/")[0]] += own
    for item in ACTIONS:
        action = bench.space.commands.actions[item.id]
        assert [m for m, entries in shown.items() if action in entries] == [item.menu]
    assert sum(len(e) for e in shown.values()) == len(ACTIONS)


def test_no_key_has_two_meanings() -> None:
    keys = Counter(QKeySequence(key).toString() for a in ACTIONS for key in a.keys)
    assert "" not in keys
    assert [k for k, count in keys.items() if count > 1] == []


def test_every_action_says_what_it_does(bench: Bench) -> None:
    for item in ACTIONS:
        assert item.tip.endswith("."), item.id
        tip = bench.space.commands.actions[item.id].toolTip()
        assert item.tip in tip
        for key in item.keys:
            assert QKeySequence(key).toString(QKeySequence.SequenceFormat.NativeText) in tip


def test_the_tool_bar_is_made_of_the_table() -> None:
    ids = [id for group in TOOLS for id in group]
    assert set(ids) - {"opacity"} <= set(BY_ID)
    assert set(SHORT_TITLES) <= set(ids)


def test_every_dialog_that_an_action_asks_for_exists(bench: Bench) -> None:
    assert {a.asks for a in ACTIONS if a.asks} <= bench.controller.dialogs


def test_the_sheet_of_keys_is_complete_and_can_be_searched(bench: Bench) -> None:
    bench.press(Qt.Key.Key_F1)
    dialog = bench.shell.findChild(QuestionDialog)
    assert dialog is not None
    bench.qtbot.waitUntil(dialog.isVisible)
    sheet = dialog.tables
    told = {row for rows in sheet.rows().values() for row in rows}
    native = QKeySequence.SequenceFormat.NativeText
    for item in ACTIONS:
        if item.keys:
            keys = " or ".join(QKeySequence(k).toString(native) for k in item.keys)
            assert (keys, item.title) in told
    assert sheet.rows("wheel").keys() == {"Mouse"}
    sheet.search.setText("refine")
    assert "Refine all objects" in "".join(c.text() for c in sheet.columns)
    assert "Wireframe" not in "".join(c.text() for c in sheet.columns)
    dialog.close()


def test_what_makes_no_sense_now_is_greyed_out(bench: Bench) -> None:
    actions = bench.space.commands.actions
    assert not actions["undo"].isEnabled()
    assert actions["flip_x"].isEnabled()
    bench.press("n")  # the ball has no pose
    bench.qtbot.waitUntil(lambda: not actions["flip_x"].isEnabled())
    assert not actions["refine"].isEnabled()
    assert actions["rename"].isEnabled()
    bench.press("p")
    bench.press(Qt.Key.Key_Right)
    bench.qtbot.waitUntil(actions["undo"].isEnabled)
    assert actions["undo"].text() == "Undo Move box_1"


def test_switches_show_how_things_are(bench: Bench) -> None:
    actions = bench.space.commands.actions
    assert actions["style_textured"].isChecked()
    bench.press("2")
    bench.qtbot.waitUntil(actions["style_wireframe"].isChecked)
    assert not actions["style_textured"].isChecked()
    bench.press("2")
    bench.qtbot.wait(20)
    assert actions["style_wireframe"].isChecked()
    bench.press("]")
    assert bench.space.toolbar.opacity.slider.value() == 65
    bench.space.toolbar.opacity.slider.setValue(30)
    assert bench.controller.options.opacity == 0.3
