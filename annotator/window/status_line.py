"""The line below: what to do next, what is being computed, what is saved."""

from __future__ import annotations

from PySide6.QtCore import QSize, Qt, QTimer
from PySide6.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QSizePolicy, QToolButton, QWidget

from annotator.desk.controller import Controller
from annotator.desk.events import Event
from annotator.desk.hints import next_hint
from annotator.window import theme
from annotator.window.icons import icon


class StatusLine(QWidget):
    """Hint, progress and saved state."""

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self._moving = False
        self.hint = QLabel()
        self.hint.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self.busy = QLabel()
        self.progress = QProgressBar()
        self.progress.setFixedWidth(120)
        self.progress.setTextVisible(False)
        self.cancel = QToolButton()
        self.cancel.setIcon(icon("close"))
        self.cancel.setIconSize(QSize(12, 12))
        self.cancel.setToolTip("<b>Cancel</b> Esc<br>Stop; nothing is changed.")
        self.cancel.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.cancel.clicked.connect(controller.cancel)
        self.saved = QLabel()
        row = QHBoxLayout(self)
        row.setContentsMargins(8, 2, 8, 2)
        row.setSpacing(6)
        row.addWidget(self.hint, 1)
        row.addWidget(self.busy)
        row.addWidget(self.progress)
        row.addWidget(self.cancel)
        row.addSpacing(8)
        row.addWidget(self.saved)
        # What comes and goes in it must not change the size of the views above.
        self.setFixedHeight(self.cancel.sizeHint().height() + 4)
        self._soon = QTimer(self, singleShot=True, interval=0)
        self._soon.timeout.connect(self.refresh)
        self._watch = QTimer(self, interval=150)
        self._watch.timeout.connect(self._show_progress)
        self._unsubscribe = controller.subscribe(self._on_event)
        self.refresh()

    def close_panel(self) -> None:
        self._unsubscribe()
        self._soon.stop()
        self._watch.stop()

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
            text, ink, tip = "read-only", theme.WARNING, "Nothing of this scene can be changed."
        elif session.unsaved:
            text, ink = "● not saved, journalled", theme.WARNING
            tip = (
                "Every edit stands in the scene's journal already: a crash loses none. "
                "Save (Ctrl+S) writes the labels."
            )
        else:
            text, ink, tip = "saved", theme.MUTED, "The labels in the scene are up to date."
        if text != self.saved.text():
            self.saved.setText(text)
            self.saved.setStyleSheet(f"color: {ink}")
            self.saved.setToolTip(tip)

    def _show_progress(self) -> None:
        task = self._controller.task
        # What nothing may be edited beside cannot be stopped halfway.
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
            return  # only how far it moved is new
        self._moving = self._controller.dragging is not None
        if event.kind not in ("message", "look") and not self._soon.isActive():
            self._soon.start()
