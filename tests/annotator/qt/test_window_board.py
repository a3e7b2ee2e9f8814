"""The board of a project in the window: from the queue to a scene and back, and reviews."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from bench import Bench
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QDialog

from annotator.qt.board_panel import BoardPage
from annotator.session import Session
from std_toolkit.io import locks
from std_toolkit.io.locks import DEAD_S
from std_toolkit.project.record import Project, Rules, create_project
from std_toolkit.scene.review import read_reviews
from tests.std_toolkit.project.lab import copied, template

OpenBench = Callable[..., Bench]
LEFT = Qt.MouseButton.LeftButton


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return template(tmp_path_factory.mktemp("lab") / "template")


@pytest.fixture
def lab(rendered: Path, tmp_path: Path) -> Project:
    for name, by, grade in (("fits", "Ann", "fits"), ("doubt", "Ann", "doubtful")):
        copied(rendered, tmp_path / name, by=by, grade=grade)  # type: ignore[arg-type]
    copied(rendered, tmp_path / "bare", grade=None)
    folders = [tmp_path / name for name in ("fits", "doubt", "bare")]
    project, _ = create_project(
        tmp_path / "p", scenes=folders, people=["Ann", "Ben"], rules=Rules(twice_every=0)
    )
    return project


def board(bench: Bench) -> BoardPage:
    page = bench.shell.start_page
    assert isinstance(page, BoardPage)
    bench.qtbot.waitUntil(lambda: page.scenes.count() > 0, timeout=20_000)
    return page


def names(shown) -> list[str]:
    return [shown.item(i).text() for i in range(shown.count()) if not shown.item(i).isHidden()]


def test_from_the_queue_to_the_scene_and_back(open_bench: OpenBench, lab: Project) -> None:
    bench = open_bench(annotator="Ben", project=lab)
    page = board(bench)
    assert names(page.due) == ["doubt", "fits", "bare"] and names(page.scenes)[0] == "fits"
    assert page.detail.text() == "box_1 is doubtful: it doubtful"
    page.search.setText("label bare")
    assert names(page.scenes) == ["bare"] and page.all_head.text() == "Scenes: 1 of 3"
    page.due.setFocus()
    page.due.setCurrentRow(2)
    assert page.open_button.text() == "Label" and not page.review_button.isEnabled()
    bench.press(Qt.Key.Key_Return)
    bench.settle()
    assert bench.session.annotator == "Ben" and bench.session.writable
    bench.controller.ask("close")
    bench.qtbot.waitUntil(lambda: isinstance(bench.shell.start_page, BoardPage), timeout=10_000)
    page = board(bench)
    assert bench.shell.isVisible() and bench.shell.windowTitle() == "p · std-annotate"
    page.due.setCurrentRow(0)
    QTest.mouseClick(page.open_button, LEFT)
    bench.settle()
    assert not bench.session.writable  # a reviewer looks


def test_a_review_in_the_window_keeps_the_rules(open_bench: OpenBench, lab: Project) -> None:
    bench = open_bench(annotator="Ben", project=lab)
    page = board(bench)
    bench.answering("accept")
    QTest.mouseClick(page.review_button, LEFT)
    assert "ox_1 is doubtful and has no reason of Ben" in page.problem.text.text()
    assert page.problem.again.isHidden()

    def give(dialog: QDialog) -> None:
        dialog.widgets["about: box_1"].setPlainText("the rim fits")  # type: ignore[attr-defined]
        QTest.mouseClick(dialog.buttons["accept"], LEFT)  # type: ignore[attr-defined]

    bench.in_dialog(give)
    QTest.mouseClick(page.review_button, LEFT)
    (row,) = read_reviews(lab.folder(lab.find("doubt"))).reviews
    assert (row.by, row.verdict, row.reasons) == ("Ben", "accepted", {"box_1": "the rim fits"})
    assert not page.problem.isVisible()
    bench.qtbot.waitUntil(lambda: names(page.due) == ["fits", "bare"], timeout=10_000)


def test_a_stranger_looks_only_and_a_scene_that_is_held_names_its_holder(
    open_bench: OpenBench, lab: Project, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = open_bench(annotator="kim", project=lab)
    page = board(bench)
    assert names(page.due) == [] and "kim, not one of its people" in page.about.text()
    page.scenes.setCurrentRow(0)
    assert not page.review_button.isEnabled() and not page.comment_button.isEnabled()
    root = lab.folder(lab.find("fits"))
    with monkeypatch.context() as there:
        there.setattr(socket, "gethostname", lambda: "lab2")
        there.setattr(locks, "BEAT_S", 1e6)
        held = Session.open(root, annotator="Ann")
    QTest.mouseClick(page.open_button, LEFT)
    page = board(bench)
    assert page.problem.isVisible() and "annotator Ann" in page.problem.text.text()
    assert page.problem.take.isHidden()
    old = time.time() - DEAD_S - 60
    os.utime(root / ".std/annotate.lock", (old, old))
    QTest.mouseClick(page.problem.again, LEFT)
    page = board(bench)
    assert "not heard of for 4 minutes" in page.problem.text.text()
    QTest.mouseClick(page.problem.take, LEFT)
    bench.settle()
    assert bench.session.writable
    held.close()
