"""A person at the window of std-annotate, for the pictures of the guide: real events, counted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QEventLoop, QMimeData, QPoint, QPointF, Qt, QTimer, QUrl
from PySide6.QtGui import QDragEnterEvent, QDropEvent, QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog, QWidget

from annotator.qt.library_panel import MODEL_MIME
from annotator.qt.main_window import Shell

LEFT, PLAIN = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier


def let_work(milliseconds: int) -> None:
    """Let the window and its threads work; `QTest.qWait` would keep Python from the threads."""
    loop = QEventLoop()
    QTimer.singleShot(milliseconds, loop.quit)
    loop.exec()


def at_scene(scene: Path) -> Hands:
    """Hands at a new window that shows a scene."""
    from annotator.qt.qt_app import make_application

    make_application()
    shell = Shell(annotator="mk")
    shell.resize(1280, 720)
    shell.show()
    shell.activateWindow()
    QTest.qWait(500)
    assert shell.open_scene(scene, recover="no")
    hand = Hands(shell)
    hand.settle()
    return hand


class Hands:
    """Hands at a window.

    Attributes:
        actions: what they did so far: one press of a key, one click, one drag each.
    """

    def __init__(self, shell: Shell) -> None:
        self.shell = shell
        self.actions = 0

    @property
    def controller(self) -> Any:
        return self.shell.controller

    @property
    def space(self) -> Any:
        return self.shell.workspace

    # --- waiting ---------------------------------------------------------------------------------

    def wait(self, until: Callable[[], bool], seconds: float = 900.0) -> None:
        """Let the window work until something is so."""
        for _ in range(round(seconds / 0.05)):
            if until():
                return
            let_work(50)
        raise TimeoutError

    def settle(self) -> None:
        """Until every computation is over and every view is in full detail."""
        views = self.space.views.views
        let_work(200)
        self.wait(lambda: self.controller.task is None)
        self.wait(lambda: not views.shapes.pending and not any(v.moving for v in views.views))
        let_work(800)

    # --- doing -----------------------------------------------------------------------------------

    def press(self, key: Qt.Key, modifiers: Any = PLAIN, times: int = 1) -> None:
        for _ in range(times):
            QTest.keyClick(QApplication.focusWidget() or self.shell, key, modifiers)
            self.actions += 1
        self.settle()

    def click(self, widget: QWidget, place: QPoint | None = None) -> None:
        QTest.mouseClick(widget, LEFT, PLAIN, place or widget.rect().center())
        self.actions += 1
        let_work(100)

    def drag(
        self,
        start: QPoint,
        by: QPoint,
        modifiers: Any = PLAIN,
        *,
        drop: bool = True,
        look: Callable[[], None] = lambda: None,
    ) -> None:
        """In the main view; `look` is called on the way."""
        view = self.space.views.tiles[0].view
        QTest.mouseMove(view, start)
        QTest.mousePress(view, LEFT, modifiers, start)
        for i in range(1, 9):
            QTest.mouseMove(view, start + by * i / 8)
            let_work(20)
            look()
        if drop:
            QTest.mouseRelease(view, LEFT, modifiers, start + by)
            self.actions += 1
            self.settle()

    def drop_files(self, paths: list[Path]) -> None:
        """Mesh files from the desktop onto the library."""
        data = QMimeData()
        data.setUrls([QUrl.fromLocalFile(str(p)) for p in paths])
        self._drop(data, self.space.library, QPoint(20, 60))

    def drop_mesh(self, model: str, uv: NDArray[np.floating]) -> None:
        """A mesh of the library onto a pixel of the main view."""
        data = QMimeData()
        data.setData(MODEL_MIME, model.encode())
        self._drop(data, self.space.views.tiles[0].view, self.at(uv))

    def choose_material(self, material: str) -> None:
        """Open the list and click: two actions."""
        box = self.space.objects.material
        box.setCurrentText(material)
        box.activated.emit(box.currentIndex())
        self.actions += 2
        self.settle()

    def answer(self, act: Callable[[QDialog], None]) -> None:
        """Do something with the next dialog."""

        def look() -> None:
            dialog = QApplication.activeModalWidget()
            if isinstance(dialog, QDialog):
                act(dialog)
            else:
                QTimer.singleShot(20, self.shell, look)

        QTimer.singleShot(0, self.shell, look)

    def _drop(self, data: QMimeData, on: QWidget, place: QPoint) -> None:
        copy = Qt.DropAction.CopyAction
        QApplication.sendEvent(on, QDragEnterEvent(place, copy, data, LEFT, PLAIN))
        QApplication.sendEvent(on, QDropEvent(QPointF(place), copy, data, LEFT, PLAIN))
        self.actions += 1
        self.settle()

    # --- seeing ----------------------------------------------------------------------------------

    def at(self, uv: NDArray[np.floating]) -> QPoint:
        """Where the main view shows a pixel of the recorded image."""
        view = self.space.views.views.views[0]
        x, y = view.screen_of_recorded(np.array([uv], dtype=float))[0]
        return QPoint(int(x), int(y))

    def picture(self, *widgets: QWidget) -> NDArray[np.uint8]:
        """The window, or the part of it that holds some widgets: (H, W, 3) RGB."""
        let_work(400)
        image = self.shell.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
        rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), -1)
        rgb = rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()
        if not widgets:
            return rgb
        corners = [
            (w.mapTo(self.shell, QPoint(0, 0)), w.mapTo(self.shell, w.rect().bottomRight()))
            for w in widgets
        ]
        left, top = min(a.x() for a, _ in corners), min(a.y() for a, _ in corners)
        right, bottom = max(b.x() for _, b in corners), max(b.y() for _, b in corners)
        return rgb[top : bottom + 1, left : right + 1]
