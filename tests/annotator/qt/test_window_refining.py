"""Refining and measuring from the window: one edit each, and told in the panels."""

from __future__ import annotations

import time

import numpy as np
import pytest
from bench import Bench
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel
from window_scene import T_WORLD_BOX, camera_pose

from annotator.app.events import Event
from annotator.qt import theme
from annotator.session import Move
from annotator.session.residuals import FrameResidual
from std_toolkit.checks.measure.ranking import PoseRank
from std_toolkit.geometry import SE3, rotation_angle
from std_toolkit.labels.texture.comparison import TextureComparison

CONTROL = Qt.KeyboardModifier.ControlModifier
TRUTH = camera_pose(0).inverse() @ T_WORLD_BOX


def _disturb(bench: Bench) -> None:
    edit = Move(object="box_1", frame=0, shift_mm=[6, -5, 8], turn_deg=[2, -3, 2])
    bench.session.apply(edit)
    bench.settle()


def _idle(bench: Bench) -> None:
    bench.qtbot.waitUntil(lambda: bench.controller.task is None, timeout=120_000)


@pytest.mark.slow
def test_refining_is_one_edit_that_undo_takes_back(bench: Bench) -> None:
    _disturb(bench)
    before, steps = bench.pose().flat(), len(bench.session.steps)
    bench.press("r")
    assert bench.controller.task is not None
    bench.qtbot.waitUntil(lambda: "Refine box_1" in bench.space.status.busy.text())
    _idle(bench)
    found = bench.pose()
    assert len(bench.session.steps) == steps + 1
    assert np.linalg.norm(found.t - TRUTH.t) < 0.0015
    assert np.degrees(rotation_angle(found.R @ TRUTH.R.T)) < 0.7
    assert "box_1: moved by" in bench.message()
    rows = bench.space.objects.model.rows
    assert rows[0].state == "refined"
    assert "views" in bench.space.pose.provenance.text()
    bench.press("z", CONTROL)
    assert bench.pose().flat() == before
    bench.press("y", CONTROL)
    assert bench.pose().flat() == found.flat()


@pytest.mark.slow
def test_an_object_moved_meanwhile_keeps_the_pose_of_the_hand(bench: Bench) -> None:
    _disturb(bench)
    bench.press("r")
    bench.press(Qt.Key.Key_Right)
    by_hand = bench.pose().flat()
    _idle(bench)
    assert bench.pose().flat() == by_hand
    assert "edited meanwhile" in bench.message()


@pytest.mark.slow
def test_refining_can_be_cancelled(bench: Bench) -> None:
    _disturb(bench)
    before = bench.pose().flat()
    bench.press("r")
    bench.qtbot.waitUntil(bench.space.status.cancel.isVisible)
    bench.press(Qt.Key.Key_Escape)
    _idle(bench)
    assert bench.pose().flat() == before
    assert "nothing was changed" in bench.message()


def test_residuals_come_by_themselves_and_go_when_the_object_moves(bench: Bench) -> None:
    rows = bench.space.objects.model.rows
    bench.qtbot.waitUntil(lambda: "box_1" in bench.controller.residuals, timeout=30_000)
    panel = bench.space.residuals
    assert panel.table.rowCount() == 4
    bench.qtbot.waitUntil(lambda: "box_1" in bench.controller.ranks, timeout=30_000)
    # Nothing is called a fit before it has been judged.
    known = bench.controller.findings.judgements
    bench.qtbot.waitUntil(lambda: "box_1" in known, timeout=60_000)
    rows = bench.space.objects.model.rows
    assert rows[0].badge.endswith("px")
    assert rows[0].grade == "fits"
    card = bench.space.evidence
    assert card.word.text() == "fits"
    assert card.reason.text().startswith("Contour and depth confirm it to ±")
    rows = {row.source: row for row in card.rows}
    assert rows["nearby poses"].text == "beats 200 of 200"
    assert rows["texture"].text == "none: turns look the same"
    assert rows["contour"].grade == rows["depth"].grade == rows["nearby poses"].grade == "fits"
    bench.press(Qt.Key.Key_Right)
    assert "box_1" not in bench.controller.residuals
    assert bench.space.objects.model.rows[0].badge == ""


def test_edges_at_the_level_of_chance_are_not_called_good(bench: Bench) -> None:
    bench.controller.residuals["box_1"] = [
        FrameResidual(0, 900, edge_px=1.1, edge_chance_px=1.3, depth_mm=0.3),
        FrameResidual(1, 900, edge_px=0.6, edge_chance_px=4.0, depth_mm=40.0),
    ]
    panel = bench.space.residuals
    panel.refresh()

    def ink(row: int, column: int) -> str:
        item = panel.table.item(row, column)
        assert item is not None
        return item.foreground().color().name()

    assert [ink(0, 1), ink(0, 3)] == [theme.MUTED, theme.GOOD]
    assert [ink(1, 1), ink(1, 3)] == [theme.GOOD, theme.BAD]


def test_objects_that_run_into_each_other_are_told(bench: Bench) -> None:
    from annotator.session import SetPoses
    from std_toolkit.geometry import SE3

    middle = SE3(np.eye(3), bench.pose().t)
    bench.session.apply(SetPoses.one("ball_1", 0, middle, method="typed"))
    bench.qtbot.waitUntil(lambda: bool(bench.controller.penetrations), timeout=60_000)
    rows = bench.space.objects.model.rows
    assert rows[1].alarm.endswith("into box_1")
    bench.press("z", CONTROL)
    bench.qtbot.waitUntil(lambda: not bench.controller.penetrations, timeout=60_000)


def test_the_window_answers_while_something_is_computed(bench: Bench) -> None:
    """A key takes effect while a computation runs that never ends by itself.

    It holds the interpreter's lock, as hardly any does for long, on a machine that may be busy.
    """

    def busy(task: object) -> None:
        values = np.random.default_rng(0).normal(size=20_000).tolist()
        while not task.cancelled:  # type: ignore[attr-defined]
            sorted(values)

    def press() -> float:
        before, began = bench.pose(), time.monotonic()
        bench.press(Qt.Key.Key_Right)
        assert bench.pose().t[0] > before.t[0]
        return time.monotonic() - began

    bench.controller.start("Refine box_1", busy, lambda _: None)
    waits = [press() for _ in range(5)]
    assert bench.controller.task is not None
    bench.press(Qt.Key.Key_Escape)
    _idle(bench)
    assert np.median(waits) < 2.0


def test_a_rival_that_leads_is_read_as_a_whole(bench: Bench) -> None:
    c = bench.controller
    c.residuals["box_1"] = [FrameResidual(0, 900, edge_px=0.6, edge_chance_px=9.0)]
    c.ranks["box_1"] = PoseRank(200, 200, (0, 1), (0, 1), -0.1, 0.6)
    c.textures["box_1"] = TextureComparison(
        "undecided",
        SE3.identity(),
        "turned by 180 deg about z",
        0.15,
        0.27,
        8,
        0.2,
        (30, 34, 38),
    )
    card = bench.space.evidence
    c.emit(Event("verdict", objects=("box_1",)))
    bench.settle()
    text = card.reason.text()
    assert "scores 0.27 against 0.15: look at the label in frames 30 to 38" in text
    for label in (card.reason, *card.findChildren(QLabel)):
        if label.isVisible():
            needed = label.heightForWidth(label.width()) if label.wordWrap() else 1
            assert label.height() >= needed > 0
            shown = label.mapTo(bench.shell, label.rect().bottomRight())
            assert bench.shell.rect().contains(shown)
    assert card.buttons["texture"].text() == "Turn it"
    row = bench.space.objects.model.rows[0]
    assert row.grade == "doubtful"
