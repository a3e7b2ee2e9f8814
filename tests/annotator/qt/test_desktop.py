"""What all tests of the window build on: a real window, real input, a picture of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip("pyvistaqt")

import pyvista
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QMainWindow
from pytestqt.qtbot import QtBot
from pyvistaqt import QtInteractor

if TYPE_CHECKING:
    from playwright.sync_api import Page

REPOSITORY = Path(__file__).resolve().parents[3]
LEFT = Qt.MouseButton.LeftButton


@pytest.fixture
def interactor(qtbot: QtBot) -> Iterator[QtInteractor]:
    """A red cube before black in a window of 640x480 pixels."""
    window = QMainWindow()
    qtbot.addWidget(window)
    interactor = QtInteractor(window, auto_update=False, multi_samples=1)
    window.setCentralWidget(interactor)
    window.resize(640, 480)
    interactor.set_background("black")
    interactor.add_mesh(pyvista.Cube(), color="red", lighting=False)
    with qtbot.waitExposed(window):
        window.show()
    interactor.render()
    yield interactor
    interactor.close()


def test_the_window_is_drawn_in_software(interactor: QtInteractor) -> None:
    assert "llvmpipe" in interactor.render_window.ReportCapabilities()


def test_a_screenshot_shows_the_scene(interactor: QtInteractor) -> None:
    picture = interactor.screenshot(return_img=True)
    assert picture.shape == (480, 640, 3)
    red = (picture == [255, 0, 0]).all(axis=-1)
    assert red[240, 320]
    assert not red[:20].any()
    assert 0.1 < red.mean() < 0.9


def test_the_widget_shows_what_the_screenshot_does(interactor: QtInteractor) -> None:
    shown = interactor.window().grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(shown.constBits(), np.uint8).reshape(shown.height(), -1)
    pixels = rows[:, : 3 * shown.width()].reshape(shown.height(), shown.width(), 3)
    picture = interactor.screenshot(return_img=True)
    assert np.abs(pixels.astype(int) - picture).mean() < 1


def test_dragging_the_mouse_turns_the_camera(interactor: QtInteractor) -> None:
    before = np.array(interactor.camera.position)
    pressed = []
    vtk_interactor = interactor.iren.interactor
    interactor.iren.add_observer(
        "LeftButtonPressEvent", lambda *_: pressed.append(vtk_interactor.GetEventPosition())
    )
    QTest.mousePress(interactor, LEFT, pos=QPoint(320, 200))
    QTest.mouseMove(interactor, QPoint(360, 240))
    QTest.mouseMove(interactor, QPoint(400, 240))
    QTest.mouseRelease(interactor, LEFT, pos=QPoint(400, 240))
    assert pressed == [(320, 479 - 200)]  # VTK counts rows from below
    assert np.linalg.norm(np.array(interactor.camera.position) - before) > 0.1


def test_other_packages_are_tested_without_qt_and_display() -> None:
    code = (
        "import pytest, sys\n"
        "assert pytest.main(['-q', '-p', 'no:cacheprovider', 'tests/std_toolkit/test_errors.py'])"
        " == 0\n"
        "print([m for m in ('PySide6', 'pytestqt', 'vtkmodules', 'pyvista') if m in sys.modules])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code],
        env={"PATH": "/usr/bin:/bin"},
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.splitlines()[-1] == "[]"


def test_the_browser_draws_a_page(page: Page) -> None:
    page.set_content("<body style='background: #00f'><h1>labels</h1></body>")
    assert page.inner_text("h1") == "labels"
    assert page.screenshot().startswith(b"\x89PNG")
