"""Widgets of the main view and the side views, rendered by a `ViewSet`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PySide6.QtCore import QEvent, QObject, QSize, Qt, QTimer, Signal
from PySide6.QtGui import (
    QAction,
    QDragEnterEvent,
    QDragMoveEvent,
    QDropEvent,
    QKeyEvent,
    QMouseEvent,
    QResizeEvent,
)
from PySide6.QtWidgets import QFrame, QHBoxLayout, QSplitter, QToolButton, QVBoxLayout, QWidget
from pyvistaqt import QtInteractor

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.placing import drop_model, drop_object
from annotator.qt import graphics, library_panel, object_panel, panel, theme
from annotator.qt.commands import Commands
from annotator.qt.theme import icon
from annotator.views import ViewSet
from annotator.views.meshes import ShapeStore
from std_toolkit.errors import ToolkitError

# Smallest width of the side views, and largest one as a fraction of the whole.
SIDE_WIDTH, _WIDEST_SIDE = 260, 0.34

_MARGIN = 6


class ViewArea(QWidget):
    """All views of a scene.

    Attributes:
        tiles: tiles of the views, the main view first.
        own_widths: whether a person has chosen the width of the side views.
    """

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__()
        self._controller = controller
        self.tiles = [
            ViewTile(controller, commands, slot) for slot in range(len(controller.view_frames))
        ]
        self.column = QSplitter(Qt.Orientation.Vertical)
        for tile in self.tiles[1:]:
            self.column.addWidget(tile)
        self.split = QSplitter(Qt.Orientation.Horizontal)
        self.split.addWidget(self.tiles[0])
        if len(self.tiles) > 1:
            self.split.addWidget(self.column)
        self.split.setStretchFactor(0, 1)
        self.split.setStretchFactor(1, 0)
        self.split.setSizes([10_000, SIDE_WIDTH])
        self.own_widths = False
        self.split.splitterMoved.connect(self._keep_widths)
        for split in (self.split, self.column):
            split.setHandleWidth(3)
            split.setChildrenCollapsible(False)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.split)
        for tile in self.tiles:
            tile.view.model_dropped.connect(
                lambda id, x, y, slot=tile.slot: self._drop(drop_model, id, slot, x, y)
            )
            tile.view.object_dropped.connect(
                lambda name, x, y, slot=tile.slot: self._drop(drop_object, name, slot, x, y)
            )
        self.views: ViewSet | None = None
        self._unsubscribe = controller.subscribe(self._on_event)

    def start(self) -> ShapeStore:
        """Build the views, whose widgets must be in the window; returns their meshes."""
        ratio = self.devicePixelRatioF()
        plotters = [tile.view for tile in self.tiles]
        self.views = ViewSet(self._controller, plotters, later=self.later, pixel_ratio=ratio)
        return self.views.shapes

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._fit_column()

    def _keep_widths(self, *_: object) -> None:
        self.own_widths = True

    def _fit_column(self) -> None:
        """Make the side views as wide as their images, unless a person has moved the handle."""
        if self.own_widths or len(self.tiles) < 2 or self._controller.options.maximised:
            return
        scene = self._controller.session.scene
        camera = scene.camera(scene.frames[0])
        width = camera.width / camera.height * self.height() / (len(self.tiles) - 1)
        column = round(max(min(width, _WIDEST_SIDE * self.width()), SIDE_WIDTH))
        self.split.setSizes([max(self.width() - column, 1), column])

    def _arrange(self) -> None:
        """Show all views, or the active one alone."""
        only = self._controller.active_view if self._controller.options.maximised else None
        self.column.setVisible(only != 0)
        for tile in self.tiles:
            tile.setVisible(only is None or tile.slot == only)

    def close_panel(self) -> None:
        self._unsubscribe()
        if self.views is not None:
            self.views.close()
        for tile in self.tiles:
            tile.view.close()

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        """Call a function in this thread after a delay, unless the views are closed by then."""
        QTimer.singleShot(round(1000 * seconds), self, call)

    def _drop(self, drop: Callable[..., bool], what: str, slot: int, x: float, y: float) -> None:
        if self.views is not None:
            self.views.drop(slot, np.array([x, y]), drop, what)

    def _on_event(self, event: Event) -> None:
        if event.kind in ("frames", "tool", "view", "edited"):
            for tile in self.tiles:
                tile.refresh()
            self._arrange()


class ViewTile(QFrame):
    """Frame of one view with buttons in its corner; the active view has a bright edge."""

    def __init__(self, controller: Controller, commands: Commands, slot: int) -> None:
        super().__init__()
        self._controller = controller
        self.slot = slot
        self._active: bool | None = None
        self.setObjectName("tile")
        self.view = ViewWidget(self)
        self.view.setAccessibleName("Main view" if slot == 0 else f"Side view {slot}")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(1, 1, 1, 1)
        layout.addWidget(self.view)
        self.corner = QWidget(self.view)
        self.corner.setObjectName("corner")
        row = QHBoxLayout(self.corner)
        row.setContentsMargins(1, 1, 1, 1)
        row.setSpacing(1)
        if slot == 0:
            for id in ("fit_view", "zoom_object"):
                row.addWidget(_corner_button(commands.actions[id]))
        else:
            # The frame of a side view is selected automatically and can be changed.
            for by, name, tip in ((-1, "previous", "Earlier frame"), (1, "next", "Later frame")):
                button = _corner_button(label=f"{tip} in this view")
                button.setIcon(icon(name))
                button.setToolTip(f"{tip} in this view")
                button.setAutoRepeat(True)
                button.clicked.connect(lambda _=False, by=by: self._step(by))
                row.addWidget(button)
            row.addWidget(_corner_button(commands.actions[f"swap_{slot}"]))
        self.view.installEventFilter(self)
        self.refresh()

    def refresh(self) -> None:
        """Show which view is active."""
        active = self._controller.active_view == self.slot
        if active is self._active:
            return
        self._active = active
        theme.mark(self, "inhand", str(active).lower())

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self.view and event.type() == QEvent.Type.Resize:
            self.corner.adjustSize()
            self.corner.move(self.view.width() - self.corner.width() - _MARGIN, _MARGIN)
        return super().eventFilter(watched, event)

    def _step(self, by: int) -> None:
        """Show the next frame in which objects can have poses."""
        c = self._controller
        ids = list(c.session.frames)
        here = c.view_frames[self.slot]
        at = ids.index(here) if here in ids else 0
        target = ids[min(max(at + by, 0), len(ids) - 1)]
        try:
            c.show_frame(target, self.slot)
        except ToolkitError as error:
            c.tell(str(error), "error")


def _corner_button(action: QAction | None = None, *, label: str = "") -> QToolButton:
    button = panel.tool_button(action, name=label)
    button.setIconSize(QSize(16, 16))
    return button


class ViewWidget(QtInteractor):
    """Plotter widget that renders on request and accepts drops.

    Signals:
        model_dropped: id of a model, and position in physical pixels from the top left corner.
        object_dropped: name of an object, and position.
        files_dropped: mesh files (list of Path).
    """

    model_dropped = Signal(str, float, float)
    object_dropped = Signal(str, float, float)
    files_dropped = Signal(list)

    def __init__(self, parent: QWidget | None = None) -> None:
        self._drawn = False
        super().__init__(parent, auto_update=False, multi_samples=graphics.multi_samples())
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAcceptDrops(True)
        self.setMinimumSize(120, 90)

    # --- drawing ---------------------------------------------------------------------------------

    def Render(self) -> None:
        """Request a repaint in the next pass of the event loop."""
        self._drawn = False
        super().Render()

    def _cb_frame(self, obj: object, event: str) -> None:
        self._drawn = True
        super()._cb_frame(obj, event)

    def paintGL(self) -> None:
        # Changes request a repaint. Qt also paints after the window was covered, and after a
        # rendering outside of this method, which need not be repeated.
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
        # All sizes, including fonts, are in physical pixels; VTK would scale them again.
        self._RenderWindow.SetDPI(72)

    # --- keys ------------------------------------------------------------------------------------

    def keyPressEvent(self, event: QKeyEvent) -> None:
        # Disables the key bindings of VTK (q closes, w changes the representation).
        event.ignore()

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        event.ignore()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        self.mousePressEvent(event)

    # --- dropping --------------------------------------------------------------------------------

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        data = event.mimeData()
        if (
            data.hasFormat(library_panel.MODEL_MIME)
            or data.hasFormat(object_panel.OBJECT_MIME)
            or library_panel.mesh_files(data)
        ):
            event.acceptProposedAction()

    def dragMoveEvent(self, event: QDragMoveEvent) -> None:
        event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        data, place = event.mimeData(), event.position()
        ratio = self.devicePixelRatioF()
        x, y = place.x() * ratio, place.y() * ratio
        event.acceptProposedAction()
        self.setFocus()
        files: list[Path] = library_panel.mesh_files(data)
        if data.hasFormat(library_panel.MODEL_MIME):
            self.model_dropped.emit(data.data(library_panel.MODEL_MIME).toStdString(), x, y)
        elif data.hasFormat(object_panel.OBJECT_MIME):
            self.object_dropped.emit(data.data(object_panel.OBJECT_MIME).toStdString(), x, y)
        elif files:
            self.files_dropped.emit(files)
