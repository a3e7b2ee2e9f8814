"""Pages shown without an open scene: start page with recent scenes and errors, loading page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PySide6 import QtWidgets
from PySide6.QtCore import QRectF, Qt, Signal
from PySide6.QtGui import QColor, QDragEnterEvent, QDropEvent, QImage, QPainter, QPaintEvent

from annotator.qt import theme
from annotator.qt.settings import recent_scenes
from annotator.qt.theme import icon, pixmap
from std_toolkit.errors import ToolkitError
from std_toolkit.io.locks import TAKE_OVER

_HOW = (
    "A scene is a folder that <code>std-curate import</code> makes of a recording; "
    "<code>std-curate poses</code> adds the camera poses."
)


class StartPage(QtWidgets.QWidget):
    """Page to select a scene.

    Signals:
        chosen: folder of the scene (Path), whether to open it read-only, and whether to take it
            over from a computer that is gone.
        browse: a file dialog for a folder is requested.
    """

    chosen = Signal(object, bool, bool)
    browse = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.setAcceptDrops(True)
        title = QtWidgets.QLabel("std-annotate")
        title.setObjectName("title")
        what = QtWidgets.QLabel("Align the CAD meshes of objects to a recorded scene.")
        what.setObjectName("muted")
        self.problem = ProblemCard()
        self.problem.again.clicked.connect(lambda: self._retry())
        self.problem.look.clicked.connect(lambda: self._retry(look=True))
        self.problem.take.clicked.connect(lambda: self._retry(take_over=True))

        self.open_button = QtWidgets.QPushButton(icon("open"), "Open scene folder...")
        self.open_button.setObjectName("primary")
        self.open_button.clicked.connect(self.browse)
        how = QtWidgets.QLabel(_HOW)
        how.setObjectName("muted")
        how.setWordWrap(True)

        self.heading = QtWidgets.QLabel("Recent scenes")
        self.heading.setObjectName("heading")
        self.recent = QtWidgets.QListWidget()
        self.recent.setObjectName("roomy")
        self.recent.setAccessibleName("Recent scenes")
        self.recent.itemActivated.connect(self._choose)
        self.recent.itemClicked.connect(self._choose)
        self.empty = QtWidgets.QLabel("No scenes yet. Open a folder, or drop one here.")
        self.empty.setObjectName("empty")

        column = QtWidgets.QVBoxLayout()
        column.setSpacing(10)
        column.addStretch(1)
        column.addWidget(title)
        column.addWidget(what)
        column.addSpacing(6)
        column.addWidget(self.problem)
        buttons = QtWidgets.QHBoxLayout()
        buttons.addWidget(self.open_button)
        buttons.addStretch(1)
        column.addLayout(buttons)
        column.addWidget(how)
        column.addSpacing(10)
        column.addWidget(self.heading)
        column.addWidget(self.recent, 4)
        column.addWidget(self.empty)
        column.addStretch(1)
        middle = QtWidgets.QWidget()
        middle.setLayout(column)
        middle.setMaximumWidth(720)
        row = QtWidgets.QHBoxLayout(self)
        row.addStretch(1)
        row.addWidget(middle, 6)
        row.addStretch(1)
        self._tried: Path | None = None
        self.refresh()

    def refresh(self, problem: ToolkitError | None = None, tried: Path | None = None) -> None:
        """Show the recent scenes, and the error of the scene that could not be opened."""
        self._tried = tried
        self.problem.show_problem(problem)
        self.recent.clear()
        for path in recent_scenes():
            item = QtWidgets.QListWidgetItem(
                icon("folder", theme.MUTED), f"{path.name}\n{path.parent}"
            )
            item.setData(Qt.ItemDataRole.UserRole, str(path))
            self.recent.addItem(item)
        self.recent.setVisible(self.recent.count() > 0)
        self.empty.setVisible(self.recent.count() == 0)

    def _choose(self, item: QtWidgets.QListWidgetItem) -> None:
        self.chosen.emit(Path(item.data(Qt.ItemDataRole.UserRole)), False, False)

    def _retry(self, *, look: bool = False, take_over: bool = False) -> None:
        if self._tried is not None:
            self.chosen.emit(self._tried, look, take_over)

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        if any(Path(u.toLocalFile()).is_dir() for u in event.mimeData().urls()):
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        folders = [Path(u.toLocalFile()) for u in event.mimeData().urls()]
        folder = next((f for f in folders if f.is_dir()), None)
        if folder is not None:
            event.acceptProposedAction()
            self.chosen.emit(folder, False, False)


class ProblemCard(QtWidgets.QFrame):
    """Error of a scene that could not be opened, with buttons."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("card")
        sign = QtWidgets.QLabel()
        sign.setPixmap(pixmap("error", 20, theme.BAD, self.devicePixelRatioF()))
        self.text = QtWidgets.QLabel()
        self.text.setTextFormat(Qt.TextFormat.PlainText)
        self.text.setWordWrap(True)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.again = QtWidgets.QPushButton("Try again")
        self.look = QtWidgets.QPushButton("Open read-only")
        self.look.setToolTip("Nothing can be changed, and the other session is not disturbed.")
        self.take = QtWidgets.QPushButton("Take over")
        self.take.setToolTip("Only if the other computer is off: its edits stay in the journal.")
        top = QtWidgets.QHBoxLayout()
        top.addWidget(sign, 0, Qt.AlignmentFlag.AlignTop)
        top.addWidget(self.text, 1)
        buttons = QtWidgets.QHBoxLayout()
        buttons.addStretch(1)
        for button in (self.take, self.look, self.again):
            buttons.addWidget(button)
        layout = QtWidgets.QVBoxLayout(self)
        layout.addLayout(top)
        layout.addLayout(buttons)

    def show_problem(self, problem: ToolkitError | None) -> None:
        self.setVisible(problem is not None)
        if problem is not None:
            self.text.setText(describe_problem(problem))
            # The scene is readable; only writing fails.
            self.look.setVisible("read-only" in (problem.hint or ""))
            self.take.setVisible(TAKE_OVER in (problem.hint or ""))


def describe_problem(problem: ToolkitError) -> str:
    """Return an error as several lines of text."""
    text = problem.problem[:1].upper() + problem.problem[1:] + "."
    if problem.value is not None:
        text += f"\n{problem.field or 'Value'}: {problem.value}"
    if problem.path:
        text += f"\n{problem.path}"
    if TAKE_OVER in (problem.hint or ""):
        text += f"\n{problem.hint}"
    return text


class OpeningPage(QtWidgets.QWidget):
    """Shows the first image of a scene while the 3D libraries load, which takes a second."""

    def __init__(self, name: str, rgb: NDArray[np.uint8] | None) -> None:
        super().__init__()
        self._text = f"Opening {name} ..."
        self._rgb = rgb

    def paintEvent(self, _: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(theme.BASE))
        if self._rgb is not None:
            height, width = self._rgb.shape[:2]
            stride = self._rgb.strides[0]
            image = QImage(self._rgb.data, width, height, stride, QImage.Format.Format_RGB888)
            scale = min(self.width() / width, self.height() / height)
            w, h = width * scale, height * scale
            place = QRectF((self.width() - w) / 2, (self.height() - h) / 2, w, h)
            painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
            painter.drawImage(place, image)
        painter.setPen(QColor(theme.MUTED))
        margin = self.rect().adjusted(12, 8, -12, -8)
        painter.drawText(margin, Qt.AlignmentFlag.AlignBottom, self._text)
