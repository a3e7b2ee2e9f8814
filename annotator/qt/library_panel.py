"""Panel of the mesh library, with thumbnails to drag onto an image."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PySide6 import QtWidgets
from PySide6.QtCore import QMimeData, QSize, Qt, Signal
from PySide6.QtGui import QDragEnterEvent, QDragMoveEvent, QDropEvent, QIcon, QImage, QPixmap

from annotator.app.controller import Controller
from annotator.app.mesh_folder import FolderMesh, meshes_to_add
from annotator.app.placing import add_object
from annotator.app.questions import symmetry_summary
from annotator.qt.commands import Commands
from annotator.qt.panel import Panel, label, tool_button
from annotator.qt.theme import pixmap
from annotator.views.thumbnails import Thumbnails
from std_toolkit.geometry.mesh import MESH_SUFFIXES
from std_toolkit.scene import Model

MODEL_MIME = "application/x-std-annotate-model"
THUMBNAIL = 60
_EMPTY = "No meshes yet: drop mesh files, or a folder of them, here."


class LibraryPanel(Panel):
    """Meshes of the scene, then those of the folder that are not in the scene yet.

    Signals:
        files_dropped: mesh files or folders (list of Path) dropped onto the library.
    """

    KINDS = ("edited", "library")
    files_dropped = Signal(list)

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__(controller)
        self._icons: dict[str, QIcon] = {}
        self._thumbnails: Thumbnails | None = None
        self.list = _Meshes()
        self.list.setAccessibleName("Mesh library")
        self.list.itemDoubleClicked.connect(
            lambda item: add_object(controller, item.data(Qt.ItemDataRole.UserRole))
        )
        top = QtWidgets.QHBoxLayout()
        top.addWidget(label("heading", "Mesh library"))
        top.addStretch(1)
        top.addWidget(tool_button(commands.actions["add_mesh"], labelled=True))

        self.stack = QtWidgets.QStackedLayout()
        self.stack.addWidget(self.list)
        self.stack.addWidget(label("empty", _EMPTY))
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(6, 4, 6, 4)
        layout.setSpacing(4)
        layout.addLayout(top)
        layout.addLayout(self.stack, 1)
        self.setAcceptDrops(True)
        self.follow()

    def close_panel(self) -> None:
        super().close_panel()
        if self._thumbnails is not None:
            self._thumbnails.close()

    def fit_text(self) -> None:
        self.list.fit_text()

    def refresh(self) -> None:
        """Show the current meshes of the session."""
        c = self._controller
        described = {m.id: _described(m) for m in c.session.state.models}
        for mesh in meshes_to_add(c.mesh_folder, c.session):
            described[mesh.name] = _described_file(mesh)
        shown = [self.list.item(i).text() for i in range(self.list.count())]
        if shown != list(described):
            self.list.clear()
            for name in described:
                item = QtWidgets.QListWidgetItem(name)
                item.setSizeHint(self.list.gridSize())
                item.setData(Qt.ItemDataRole.UserRole, name)
                self.list.addItem(item)
        drawing = QIcon(pixmap("style_wireframe", 32))
        for i, (name, text) in enumerate(described.items()):
            self.list.item(i).setToolTip(text)
            self.list.item(i).setIcon(self._icons.get(name, drawing))
        self.stack.setCurrentIndex(0 if described else 1)

    def draw_pictures(self) -> None:
        """Render thumbnails in the background, also for meshes added later."""
        size = round(THUMBNAIL * self.devicePixelRatioF())
        self._thumbnails = Thumbnails(self._controller, self._show_pictures, size=size)

    def _show_pictures(self, pictures: dict[str, NDArray[np.uint8] | None]) -> None:
        self._icons = {id: _as_icon(picture) for id, picture in pictures.items()}
        self.refresh()

    # --- mesh files from the desktop -------------------------------------------------------------

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        if mesh_files(event.mimeData()) and self._controller.session.writable:
            event.acceptProposedAction()

    def dragMoveEvent(self, event: QDragMoveEvent) -> None:
        event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        files = mesh_files(event.mimeData())
        if files:
            event.acceptProposedAction()
            self.files_dropped.emit(files)


class _Meshes(QtWidgets.QListWidget):
    def __init__(self) -> None:
        super().__init__()
        self.setViewMode(QtWidgets.QListWidget.ViewMode.IconMode)
        self.setIconSize(QSize(THUMBNAIL, THUMBNAIL))
        self.setWordWrap(True)
        self.setItemDelegate(_Names(self))
        self.setResizeMode(QtWidgets.QListWidget.ResizeMode.Adjust)
        self.setMovement(QtWidgets.QListWidget.Movement.Static)
        self.setDragEnabled(True)
        self.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        self.setVerticalScrollMode(QtWidgets.QListWidget.ScrollMode.ScrollPerPixel)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)

    def fit_text(self) -> None:
        """Make room for names of two lines; equal sizes, so that long names displace no others."""
        line = self.fontMetrics().height()
        self.setGridSize(QSize(THUMBNAIL + 2 * line - 4, THUMBNAIL + 2 * line + 10))
        self.setMinimumHeight(THUMBNAIL + 2 * line + 18)
        for i in range(self.count()):
            self.item(i).setSizeHint(self.gridSize())

    def mimeTypes(self) -> list[str]:
        return [MODEL_MIME]

    def mimeData(self, items: list[QtWidgets.QListWidgetItem]) -> QMimeData:  # type: ignore[override]
        data = QMimeData()
        data.setData(MODEL_MIME, items[0].data(Qt.ItemDataRole.UserRole).encode())
        return data


class _Names(QtWidgets.QStyledItemDelegate):
    """Breaks long names behind underscores."""

    def displayText(self, value: object, _: object) -> str:
        return str(value).replace("_", "_\u200b")


def _as_icon(rgb: NDArray[np.uint8] | None) -> QIcon:
    if rgb is None:
        return QIcon(pixmap("error", 32))
    pixels = np.ascontiguousarray(rgb)
    height, width = pixels.shape[:2]
    image = QImage(pixels.data, width, height, 3 * width, QImage.Format.Format_RGB888)
    return QIcon(QPixmap.fromImage(image.copy()))


def mesh_files(data: QMimeData) -> list[Path]:
    """Return the mesh files and folders in drag data."""
    paths = [Path(url.toLocalFile()) for url in data.urls() if url.isLocalFile()]
    return [p for p in paths if p.suffix.lower() in MESH_SUFFIXES or p.is_dir()]


def _described_file(mesh: FolderMesh) -> str:
    return (
        f"<b>{mesh.name}</b><br>{escape(str(mesh.path))}<br>"
        "Drag it onto an image, or double-click: it is copied into the scene."
    )


def _described(model: Model) -> str:
    size = " x ".join(f"{1000 * x:.0f}" for x in model.size_m)
    turns = symmetry_summary(model.symmetry)
    return (
        f"<b>{model.id}</b><br>{size} mm, category {model.category}, {turns}<br>"
        "Drag it onto an image, or double-click."
    )
