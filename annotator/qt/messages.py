"""Status line with hint, progress and saved state, and messages over the views."""

from __future__ import annotations

from PySide6 import QtWidgets
from PySide6.QtCore import QEvent, QObject, QSize, Qt, QTimer

from annotator.app.controller import Controller
from annotator.app.events import Event, Level, Notice, Notices
from annotator.app.object_summary import next_hint
from annotator.qt import theme
from annotator.qt.panel import Panel, tool_button
from annotator.qt.theme import icon, pixmap

# Display time, seconds; errors stay until they are closed or newer messages replace them.
SHOWN_S: dict[Level, float] = {"info": 8, "warning": 20}

MOST = 3

WIDEST = 680

MARGIN = 10


class StatusLine(Panel):
    """Hint, progress and saved state."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self._moving = False
        self.hint = QtWidgets.QLabel()
        self.hint.setSizePolicy(
            QtWidgets.QSizePolicy.Policy.Ignored, QtWidgets.QSizePolicy.Policy.Preferred
        )
        self.busy = QtWidgets.QLabel()
        self.progress = QtWidgets.QProgressBar()
        self.progress.setFixedWidth(120)
        self.progress.setTextVisible(False)
        self.progress.setAccessibleName("Progress")
        self.cancel = tool_button(name="Cancel")
        self.cancel.setIcon(icon("close"))
        self.cancel.setIconSize(QSize(12, 12))
        self.cancel.setToolTip("<b>Cancel</b> Esc<br>Stop; nothing is changed.")
        self.cancel.clicked.connect(controller.cancel)
        self.saved = QtWidgets.QLabel()
        row = QtWidgets.QHBoxLayout(self)
        row.setContentsMargins(8, 2, 8, 2)
        row.setSpacing(6)
        row.addWidget(self.hint, 1)
        row.addWidget(self.busy)
        row.addWidget(self.progress)
        row.addWidget(self.cancel)
        row.addSpacing(8)
        row.addWidget(self.saved)
        self._soon = QTimer(self, singleShot=True, interval=0)
        self._soon.timeout.connect(self.refresh)
        self._watch = QTimer(self, interval=150)
        self._watch.timeout.connect(self._show_progress)
        self.follow()

    def close_panel(self) -> None:
        super().close_panel()
        self._soon.stop()
        self._watch.stop()

    def fit_text(self) -> None:
        # Changes of its content must not resize the views above.
        needed = max(self.cancel.sizeHint().height(), self.fontMetrics().height() + 4)
        self.setFixedHeight(needed + 4)

    def refresh(self) -> None:
        c = self._controller
        hint = next_hint(c)
        if hint != self.hint.text():
            self.hint.setText(hint)
            self.hint.setToolTip(hint)
        self._show_progress()
        if c.task is not None and not self._watch.isActive():
            self._watch.start()
        session = c.session
        if not session.writable:
            text, ink, tip = "read-only", "warning", "This scene cannot be changed."
        elif session.unsaved:
            text, ink = "● not saved, journalled", "warning"
            tip = (
                "Every edit is already in the scene's journal: a crash loses none. "
                "Save (Ctrl+S) writes the labels."
            )
        else:
            text, ink, tip = "saved", "muted", "The labels in the scene are up to date."
        if text != self.saved.text():
            self.saved.setText(text)
            theme.set_ink(self.saved, ink)
            self.saved.setToolTip(tip)

    def _show_progress(self) -> None:
        task = self._controller.task
        # Tasks that block edits cannot be cancelled.
        shown = {self.busy: task, self.progress: task}
        shown[self.cancel] = None if task is None or task.alone else task
        for widget, reason in shown.items():
            if widget.isHidden() != (reason is None):
                widget.setVisible(reason is not None)
        if task is None:
            self._watch.stop()
            return
        self.busy.setText("Stopping ..." if task.cancelled else f"{task.title} ...")
        if task.fraction is None:
            self.progress.setRange(0, 0)
        else:
            self.progress.setRange(0, 1000)
            self.progress.setValue(round(1000 * task.fraction))

    def _on_event(self, event: Event) -> None:
        if event.kind == "preview" and self._moving == (self._controller.dragging is not None):
            return  # only the pose of the drag has changed
        self._moving = self._controller.dragging is not None
        if event.kind not in ("message", "look") and not self._soon.isActive():
            self._soon.start()


class Banner(QtWidgets.QWidget):
    """The latest messages, newest at the bottom; hidden if there are none.

    It floats over the bottom of a widget, so that the views keep position and size.
    """

    def __init__(self, over: QtWidgets.QWidget) -> None:
        super().__init__(over)
        self._over = over
        over.installEventFilter(self)
        self._layout = QtWidgets.QVBoxLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setSpacing(2)
        self.messages: list[Message] = []
        self.notices = Notices(
            self._show,
            lambda seconds, call: QTimer.singleShot(round(1000 * seconds), self, call),
            seconds=SHOWN_S,
            most=MOST,
        )
        self.hide()

    def _show(self, notices: list[Notice]) -> None:
        shown = {message.notice: message for message in self.messages}
        self.messages = [shown[n] if n in shown else self._added(n) for n in notices]
        for message in shown.values():
            if message in self.messages:
                continue
            self._layout.removeWidget(message)
            message.hide()
            message.deleteLater()
        self._arrange()

    def _added(self, notice: Notice) -> Message:
        message = Message(notice)
        message.close_button.clicked.connect(lambda: self.notices.close(notice.number))
        self._layout.addWidget(message)
        # The layout reserves no space for it until it is shown.
        message.show()
        return message

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self._over and event.type() == QEvent.Type.Resize:
            self._arrange()
        return super().eventFilter(watched, event)

    def _arrange(self) -> None:
        """Place it at the bottom, with a readable width."""
        self.setVisible(bool(self.messages))
        if self.messages:
            width = min(self._over.width() - 2 * MARGIN, WIDEST)
            self.setFixedWidth(max(width, 200))
            self.adjustSize()
            height = self._layout.totalHeightForWidth(self.width())
            self.resize(self.width(), height if height > 0 else self.sizeHint().height())
            self.move(MARGIN, self._over.height() - self.height() - MARGIN)
            self.raise_()


class Message(QtWidgets.QFrame):
    """One message, with a coloured edge and an icon for its level."""

    def __init__(self, notice: Notice) -> None:
        super().__init__()
        self.notice, self.text, level = notice, notice.text, notice.level
        self.setObjectName("message")
        theme.mark(self, "level", level)
        sign = QtWidgets.QLabel()
        sign.setPixmap(
            pixmap(
                level,
                round(0.16 * theme.look.text),
                theme.look.palette.level(level),
                self.devicePixelRatioF(),
            )
        )
        label = QtWidgets.QLabel(self.text)
        label.setTextFormat(Qt.TextFormat.PlainText)
        label.setWordWrap(True)
        label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.close_button = tool_button(name="Close this message")
        self.close_button.setIcon(icon("close", theme.MUTED))
        self.close_button.setToolTip("Close this message")
        row = QtWidgets.QHBoxLayout(self)
        row.setContentsMargins(8, 4, 4, 4)
        row.addWidget(sign, 0, Qt.AlignmentFlag.AlignTop)
        row.addWidget(label, 1)
        row.addWidget(self.close_button, 0, Qt.AlignmentFlag.AlignTop)
