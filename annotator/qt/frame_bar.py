"""Frame slider with marks for side views and registered frames, and its buttons."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QPolygonF, QWheelEvent
from PySide6.QtWidgets import QHBoxLayout, QSizePolicy, QSpinBox, QWidget

from annotator.app.controller import Controller
from annotator.app.panels import FrameMarks, frame_marks
from annotator.qt import theme
from annotator.qt.commands import Commands
from annotator.qt.panel import Panel, label, tool_button


class FrameStrip(QWidget):
    """A slider over all frames.

    Signals:
        chosen: index of the frame, from 0.
    """

    chosen = Signal(int)

    def __init__(self) -> None:
        super().__init__()
        self.count = 0
        self.at = 0
        self.marks = FrameMarks((), (), ())
        self.setMouseTracking(True)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setCursor(Qt.CursorShape.PointingHandCursor)

    def sizeHint(self) -> QSize:
        return QSize(200, 26)

    def x_of(self, index: int) -> float:
        """Return the centre of a frame's cell, logical pixels."""
        return 8 + (index + 0.5) * (self.width() - 16) / max(self.count, 1)

    def index_at(self, x: float) -> int:
        cell = (self.width() - 16) / max(self.count, 1)
        return min(max(int((x - 8) / cell), 0), max(self.count - 1, 0))

    def paintEvent(self, _: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        groove = QRectF(8, 10, self.width() - 16, 6)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(theme.BASE))
        painter.drawRoundedRect(groove, 2, 2)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)
        # Runs of frames with a camera pose.
        cell = groove.width() / max(self.count, 1)
        for first, last in self.marks.runs:
            run = QRectF(8 + first * cell, 10, (last + 1 - first) * cell, 6)
            painter.fillRect(run, QColor(theme.FAINT))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        for index in self.marks.placed:
            painter.setBrush(QColor(theme.GOOD))
            painter.drawEllipse(QPointF(self.x_of(index), 21), 2.2, 2.2)
        for index in self.marks.sides:
            x = self.x_of(index)
            painter.setBrush(QColor(theme.TEXT))
            painter.drawPolygon(QPolygonF([QPointF(x - 4, 2), QPointF(x + 4, 2), QPointF(x, 9)]))
        x = self.x_of(self.at)
        painter.setBrush(QColor(theme.ACCENT))
        painter.drawRoundedRect(QRectF(x - 3, 5, 6, 16), 2, 2)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self.chosen.emit(self.index_at(event.position().x()))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        index = self.index_at(event.position().x())
        if event.buttons() & Qt.MouseButton.LeftButton:
            self.chosen.emit(index)
        self.setToolTip(self._tooltip(index))

    def wheelEvent(self, event: QWheelEvent) -> None:
        step = -1 if event.angleDelta().y() > 0 else 1
        self.chosen.emit(min(max(self.at + step, 0), max(self.count - 1, 0)))

    def is_registered(self, index: int) -> bool:
        """Whether a frame has a camera pose."""
        return any(first <= index <= last for first, last in self.marks.runs)

    def _tooltip(self, index: int) -> str:
        if not self.count:
            return ""
        parts = [f"Frame {index + 1} of {self.count}"]
        parts.append("camera pose known" if self.is_registered(index) else "no camera pose")
        if index in self.marks.sides:
            parts.append("in a side view")
        if index in self.marks.placed:
            parts.append("an object was placed here")
        return ", ".join(parts)


class FrameBar(Panel):
    """Slider, buttons and name of the frame in the main view.

    Signals:
        left: a number was entered; the focus should return to the views.
    """

    KINDS = ("edited", "frames")
    left = Signal()

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__(controller)
        self._ids = [f.id for f in controller.session.scene.frames]
        self._place = {id: i for i, id in enumerate(self._ids)}
        self.strip = FrameStrip()
        self.strip.setAccessibleName("Frames")
        self.strip.count = len(self._ids)
        self.strip.chosen.connect(self._choose)
        self.number = QSpinBox()
        self.number.setAccessibleName("Frame in the main view")
        self.number.setRange(self._ids[0], self._ids[-1])
        self.number.setKeyboardTracking(False)
        self.number.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        self.number.setButtonSymbols(QSpinBox.ButtonSymbols.NoButtons)
        self.number.setToolTip("Number of the frame in the main view: type one to go there.")
        self.number.editingFinished.connect(self._go_to_number)
        self.number.lineEdit().returnPressed.connect(self.left)
        self.label = label("muted")
        row = QHBoxLayout(self)
        row.setContentsMargins(6, 1, 6, 1)
        row.setSpacing(4)
        for id in ("previous_frame", "next_frame"):
            button = tool_button(commands.actions[id])
            button.setAutoRepeat(True)
            row.addWidget(button)
        row.addWidget(self.number)
        row.addWidget(self.strip, 1)
        row.addWidget(self.label)
        # Frames skipped by fast slider motion are not loaded.
        self._wanted: int | None = None
        self._soon = QTimer(self, singleShot=True, interval=0)
        self._soon.timeout.connect(self._show_wanted)
        self.follow()

    def close_panel(self) -> None:
        super().close_panel()
        self._soon.stop()

    def refresh(self) -> None:
        c = self._controller
        strip = self.strip
        strip.at = self._place[c.frame]
        strip.marks = frame_marks(c)
        strip.update()
        if not self.number.hasFocus():
            self.number.setValue(c.frame)
        registered = not c.session.posed or strip.is_registered(strip.at)
        known = "" if registered else " · no camera pose"
        text = f"{strip.at + 1} of {strip.count} · {c.session.scene.frame(c.frame).name}{known}"
        if text != self.label.text():
            self.label.setText(text)
            theme.set_ink(self.label, "warning" if known else "muted")

    def _choose(self, index: int) -> None:
        self._wanted = self._ids[index]
        self.strip.at = index
        self.strip.update()
        self._soon.start()

    def _show_wanted(self) -> None:
        if self._wanted is not None:
            wanted, self._wanted = self._wanted, None
            self._controller.attempt(lambda: self._controller.show_frame(wanted))

    def _go_to_number(self) -> None:
        # Ids may have gaps: select the nearest frame.
        nearest = min(self._ids, key=lambda id: abs(id - self.number.value()))
        self._controller.attempt(lambda: self._controller.show_frame(nearest))
        self.number.setValue(nearest)
