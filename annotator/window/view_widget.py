"""One view as a widget: VTK's drawing in Qt's window, and what can be dropped onto it."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import (
    QDragEnterEvent,
    QDragMoveEvent,
    QDropEvent,
    QKeyEvent,
    QMouseEvent,
)
from PySide6.QtWidgets import QWidget
from pyvistaqt import QtInteractor

from annotator.window.graphics import multi_samples
from annotator.window.library_panel import MODEL_MIME, mesh_files
from annotator.window.object_list import OBJECT_MIME


class ViewWidget(QtInteractor):
    """A plotter that draws when it is told to.

    Signals:
        model_dropped: id of a model, and where: physical pixels from the top left corner.
        object_dropped: name of an object, and where.
        files_dropped: mesh files (list of Path).
    """

    model_dropped = Signal(str, float, float)
    object_dropped = Signal(str, float, float)
    files_dropped = Signal(list)

    def __init__(self, parent: QWidget | None = None) -> None:
        self._drawn = False
        super().__init__(parent, auto_update=False, multi_samples=multi_samples())
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAcceptDrops(True)
        self.setMinimumSize(120, 90)

    # --- drawing ---------------------------------------------------------------------------------

    def Render(self) -> None:
        """Have it drawn anew with the next pass of the event loop."""
        self._drawn = False
        super().Render()

    def _cb_frame(self, obj: object, event: str) -> None:
        self._drawn = True
        super()._cb_frame(obj, event)

    def paintGL(self) -> None:
        # Whoever changes something asks for a drawing; Qt also asks where the window was covered,
        # and after a drawing that was made outside of here. That one need not be made twice.
        if self._drawn and not self._in_paint:
            self._in_paint = True
            try:
                super().paintGL()
            finally:
                self._in_paint = False
        else:
            super().paintGL()

    def resizeGL(self, width: int, height: int) -> None:
        self._drawn = False
        super().resizeGL(width, height)
        # Sizes are physical pixels here, those of letters, too; they would be scaled once more.
        self._RenderWindow.SetDPI(72)

    # --- keys ------------------------------------------------------------------------------------

    def keyPressEvent(self, event: QKeyEvent) -> None:
        # VTK has keys of its own (q closes, w changes what is drawn); ours are the window's.
        event.ignore()

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        event.ignore()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        self.mousePressEvent(event)

    # --- dropping --------------------------------------------------------------------------------

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        data = event.mimeData()
        if data.hasFormat(MODEL_MIME) or data.hasFormat(OBJECT_MIME) or mesh_files(data):
            event.acceptProposedAction()

    def dragMoveEvent(self, event: QDragMoveEvent) -> None:
        event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        data, place = event.mimeData(), event.position()
        ratio = self.devicePixelRatioF()
        x, y = place.x() * ratio, place.y() * ratio
        event.acceptProposedAction()
        self.setFocus()
        files: list[Path] = mesh_files(data)
        if data.hasFormat(MODEL_MIME):
            self.model_dropped.emit(data.data(MODEL_MIME).toStdString(), x, y)
        elif data.hasFormat(OBJECT_MIME):
            self.object_dropped.emit(data.data(OBJECT_MIME).toStdString(), x, y)
        elif files:
            self.files_dropped.emit(files)
