"""A window under test: what a person does with it, and what it then shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QMimeData, QPoint, QPointF, Qt, QTimer
from PySide6.QtGui import QDragEnterEvent, QDropEvent, QImage, QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog, QWidget
from pytestqt.qtbot import QtBot

from annotator.app.controller import Controller
from annotator.qt.main_window import Shell
from annotator.qt.qt_app import make_application
from annotator.qt.question_dialog import QuestionDialog
from annotator.qt.workspace import Workspace
from annotator.session import Session
from std_toolkit.geometry import SE3
from std_toolkit.project.record import Project

LEFT = Qt.MouseButton.LeftButton
NO_KEYS = Qt.KeyboardModifier.NoModifier


class Bench:
    """One window of 1280x720 with the hands of a person.

    Attributes:
        questions: headings of the questions that were answered.
    """

    def __init__(
        self, qtbot: QtBot, *, annotator: str = "mk", project: Project | None = None
    ) -> None:
        make_application()
        self.qtbot = qtbot
        self.questions: list[str] = []
        self._left = False
        self.shell = Shell(annotator=annotator, project=project)
        self.shell.resize(1280, 720)
        with qtbot.waitExposed(self.shell):
            self.shell.show()
        # There is no window manager to give it the focus.
        self.shell.activateWindow()
        qtbot.waitUntil(self.shell.isActiveWindow)

    # --- what there is ---------------------------------------------------------------------------

    @property
    def controller(self) -> Controller:
        assert self.shell.controller is not None
        return self.shell.controller

    @property
    def session(self) -> Session:
        return self.controller.session

    @property
    def space(self) -> Workspace:
        assert self.shell.workspace is not None
        return self.shell.workspace

    def view(self, slot: int = 0) -> Any:
        """The drawing of a view (`SceneView`)."""
        assert self.space.views.views is not None
        return self.space.views.views.views[slot]

    def widget(self, slot: int = 0) -> Any:
        return self.space.views.tiles[slot].view

    def pose(self, name: str = "box_1", frame: int = 0) -> SE3:
        pose = self.session.pose(name, frame)
        assert pose is not None
        return pose

    def message(self) -> str:
        """The newest message of the banner, or ""."""
        messages = self.space.banner.messages
        return messages[-1].text if messages else ""

    # --- opening and closing ---------------------------------------------------------------------

    def open(self, root: Path, **options: Any) -> bool:
        opened = self.shell.open_scene(root, **options)
        if opened:
            self.settle()
        return opened

    def settle(self) -> None:
        """Until every view shows everything in full detail."""
        views = self.space.views.views
        assert views is not None
        self.qtbot.waitUntil(lambda: not views.shapes.pending, timeout=10_000)
        self.qtbot.waitUntil(lambda: not any(v.moving for v in views.views), timeout=10_000)
        self.qtbot.wait(60)

    def leave(self, answer: str = "keep") -> None:
        """Close the window as a person does; once closed it stays closed."""
        if self._left:
            return
        self._left = True
        self.answering(answer)
        self.shell.close()
        self.shell.deleteLater()
        QApplication.processEvents()

    def answering(self, *answers: str) -> None:
        """Press these buttons of the next questions, as they come up; "cancel" has no id."""
        waiting = ["" if answer == "cancel" else answer for answer in answers]

        def look() -> None:
            dialog = QApplication.activeModalWidget()
            if isinstance(dialog, QuestionDialog) and waiting:
                answer = waiting[0]
                if answer in dialog.buttons:
                    waiting.pop(0)
                    self.questions.append(f"{dialog.heading}\n{dialog.text.text()}")
                    QTest.mouseClick(dialog.buttons[answer], LEFT)
            if waiting:
                QTimer.singleShot(20, self.shell, look)

        QTimer.singleShot(0, self.shell, look)

    def in_dialog(self, act: Callable[[QDialog], None]) -> None:
        """Do something with the next dialog that comes up."""

        def look() -> None:
            dialog = QApplication.activeModalWidget()
            if isinstance(dialog, QDialog):
                act(dialog)
            else:
                QTimer.singleShot(20, self.shell, look)

        QTimer.singleShot(0, self.shell, look)

    # --- keys ------------------------------------------------------------------------------------

    def press(
        self, key: Qt.Key | str, modifiers: Any = NO_KEYS, *, on: QWidget | None = None
    ) -> None:
        """Press a key where the focus is, or on a widget."""
        if on is None:
            on = QApplication.focusWidget()
        assert on is not None, "nothing in the window has the focus"
        QTest.keyClick(on, key, modifiers)
        QApplication.processEvents()

    def hold(self, key: Qt.Key, times: int) -> None:
        """Hold a key down until the keyboard has repeated it `times` times."""
        target = self.shell.windowHandle()
        for i in range(times + 1):
            event = QKeyEvent(QKeyEvent.Type.KeyPress, key, NO_KEYS, "", i > 0)
            QApplication.sendEvent(target, event)
        QApplication.sendEvent(target, QKeyEvent(QKeyEvent.Type.KeyRelease, key, NO_KEYS))
        QApplication.processEvents()

    # --- mouse -----------------------------------------------------------------------------------

    def at(self, uv: Sequence[float], slot: int = 0) -> QPoint:
        """Where a view shows a pixel of the recorded image."""
        x, y = self.view(slot).screen_of_recorded(np.array([uv], dtype=float))[0]
        return QPoint(int(x), int(y))

    def on_object(self, name: str = "box_1", slot: int = 0) -> QPoint:
        """Where a view shows the middle of an object."""
        view = self.view(slot)
        frame = self.controller.view_frames[slot]
        centre = self.session.centre(self.session.object(name).model)
        pose = self.controller.pose(name, frame)
        assert pose is not None
        return self.at(view.recorded_camera.project(pose @ centre), slot)

    def drag(
        self,
        start: QPoint,
        by: QPoint,
        slot: int = 0,
        *,
        modifiers: Any = NO_KEYS,
        drop: bool = True,
    ) -> None:
        """Press, move in steps as a hand does, and let go."""
        widget = self.widget(slot)
        QTest.mouseMove(widget, start)
        QTest.mousePress(widget, LEFT, modifiers, start)
        for i in range(1, 6):
            QTest.mouseMove(widget, start + by * i / 5)
            self.qtbot.wait(5)
        if drop:
            QTest.mouseRelease(widget, LEFT, modifiers, start + by)
            self.settle()

    def click(self, place: QPoint, slot: int = 0, modifiers: Any = NO_KEYS) -> None:
        QTest.mouseClick(self.widget(slot), LEFT, modifiers, place)
        QApplication.processEvents()

    def drop(self, data: QMimeData, on: QWidget, place: QPoint) -> None:
        """Let go of what is dragged, on a widget."""
        copy = Qt.DropAction.CopyAction
        QApplication.sendEvent(on, QDragEnterEvent(place, copy, data, LEFT, NO_KEYS))
        QApplication.sendEvent(on, QDropEvent(QPointF(place), copy, data, LEFT, NO_KEYS))
        QApplication.processEvents()

    # --- what is seen ----------------------------------------------------------------------------

    def picture(self, widget: QWidget | None = None) -> NDArray[np.uint8]:
        """What the window, or a widget in it, looks like: (H, W, 3) RGB."""
        shown = (widget or self.shell).grab().toImage()
        image = shown.convertToFormat(QImage.Format.Format_RGB888)
        rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), -1)
        return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()
