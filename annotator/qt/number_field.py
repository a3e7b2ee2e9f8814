"""Input field for one number of a pose."""

from __future__ import annotations

from PySide6.QtCore import QLocale, Qt, Signal
from PySide6.QtGui import QKeyEvent, QWheelEvent
from PySide6.QtWidgets import QDoubleSpinBox


class NumberField(QDoubleSpinBox):
    """Shows a rounded number and signals typed changes.

    Attributes:
        edited: whether there is typed text that is not entered yet.

    Signals:
        typed: the user entered this number, or stepped to it.
        left: Esc was pressed: typed text is discarded, and the focus should leave the field.
    """

    typed = Signal(float)
    left = Signal()

    def __init__(self, unit: str, decimals: int) -> None:
        super().__init__()
        self._exact = 0.0
        self.edited = False
        self.setRange(-1e6, 1e6)
        self.setDecimals(decimals)
        self.setSuffix(f" {unit}")
        self.setLocale(QLocale.c())
        self.setKeyboardTracking(False)
        self.setAccelerated(False)
        self.setAlignment(Qt.AlignmentFlag.AlignRight)
        self.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        self.setButtonSymbols(QDoubleSpinBox.ButtonSymbols.NoButtons)
        self.lineEdit().textEdited.connect(self._on_edited)
        self.editingFinished.connect(self._enter)

    def show_number(self, value: float) -> None:
        """Show a number without emitting `typed`."""
        self._exact = value
        if not self.edited:
            self.setValue(value)

    def stepBy(self, steps: int) -> None:
        self._tell(self._exact + steps * self.singleStep())

    def _on_edited(self) -> None:
        self.edited = True

    def _enter(self) -> None:
        # Leaving an unchanged field must not round the underlying number.
        if self.edited:
            self._tell(self.value())

    def _tell(self, value: float) -> None:
        self.edited = False
        self._exact = value
        self.setValue(value)
        self.typed.emit(value)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() == Qt.Key.Key_Escape:
            self.edited = False
            self.setValue(self._exact)
            self.left.emit()
            return
        if event.text() == ",":
            # Accept a comma as the decimal separator.
            self.lineEdit().insert(".")
            self.edited = True
            return
        super().keyPressEvent(event)

    def wheelEvent(self, event: QWheelEvent) -> None:
        # Scrolling the panel must not move the object.
        if self.hasFocus():
            super().wheelEvent(event)
        else:
            event.ignore()
