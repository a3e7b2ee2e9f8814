"""Card with the verdict on the selected object: a word, its evidence, and what to do next."""

from __future__ import annotations

from PySide6 import QtWidgets
from PySide6.QtCore import Qt

from annotator.app.controller import Controller
from annotator.app.evidence_card import EvidenceRow, evidence_card
from annotator.app.panels import weak_direction
from annotator.qt import theme
from annotator.qt.commands import Commands
from annotator.qt.panel import Panel, label


class EvidencePanel(Panel):
    """The verdict in large letters, one row for each source, with the action that resolves it.

    It is hidden without a placed object, and while points are clicked.
    """

    KINDS = ("edited", "selected", "residuals", "verdict", "penetration", "frames", "tool", "saved")

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__(controller)
        self._commands = commands
        self.word = label("word")
        self.name = label("muted")
        self.reason = QtWidgets.QLabel()
        self.weak = QtWidgets.QLabel()
        theme.set_ink(self.weak, "warning")
        self.rows: list[EvidenceRow] = []
        self.buttons: dict[str, QtWidgets.QPushButton] = {}
        top = QtWidgets.QHBoxLayout()
        top.addWidget(self.word)
        top.addStretch(1)
        top.addWidget(self.name)
        self._grid = QtWidgets.QGridLayout()
        self._grid.setContentsMargins(0, 2, 0, 0)
        self._grid.setHorizontalSpacing(8)
        self._grid.setVerticalSpacing(2)
        self._grid.setColumnStretch(1, 1)
        card = QtWidgets.QFrame()
        card.setObjectName("card")
        column = QtWidgets.QVBoxLayout(card)
        column.setContentsMargins(8, 4, 8, 6)
        column.setSpacing(2)
        column.addLayout(top)
        for text in (self.reason, self.weak):
            text.setWordWrap(True)
            column.addWidget(text)
        column.addLayout(self._grid)
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(6, 4, 6, 2)
        layout.addWidget(card)
        self.follow()

    def fit_text(self) -> None:
        self.rows = []  # the grid keeps the size of its labels otherwise

    def refresh(self) -> None:
        c = self._controller
        card = None if c.clicking else evidence_card(c)
        self.setVisible(card is not None)
        if card is None:
            return
        self.word.setText(card.word)
        theme.set_ink(self.word, card.word)
        self.word.setAccessibleName(f"Verdict on {card.name}: {card.word}")
        self.name.setText(card.name)
        self.reason.setText(card.reason)
        self.weak.setText(weak_direction(c))
        self.weak.setVisible(bool(self.weak.text()))
        if list(card.rows) != self.rows:
            self.rows = list(card.rows)
            self._show_rows()

    def _show_rows(self) -> None:
        while (item := self._grid.takeAt(0)) is not None:
            if (widget := item.widget()) is not None:
                widget.hide()
                widget.deleteLater()
        self.buttons = {}
        line = 0
        for row in self.rows:
            self._grid.addWidget(label("muted", row.source), line, 0)
            value = QtWidgets.QLabel(row.text)
            theme.set_ink(value, row.grade)
            value.setWordWrap(True)
            value.setToolTip(row.tip)
            self._grid.addWidget(value, line, 1)
            if row.action:
                self._grid.addWidget(self._button(row), line, 2)
            line += 1
            # What fits needs no words, and what the verdict says is there already.
            if row.tip and row.grade != "fits" and row.tip not in self.reason.text():
                tip = label("muted", row.tip)
                tip.setWordWrap(True)
                self._grid.addWidget(tip, line, 0, 1, 3)
                line += 1

    def _button(self, row: EvidenceRow) -> QtWidgets.QPushButton:
        button = QtWidgets.QPushButton(row.label)
        button.setObjectName("small")
        button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        button.setAccessibleName(f"{row.source}: {row.label}")
        button.clicked.connect(lambda: self._act(row))
        self.buttons[row.source] = button
        return button

    def _act(self, row: EvidenceRow) -> None:
        c = self._controller
        if row.frame is not None:
            frame = row.frame
            c.attempt(lambda: c.show_frame(frame))
        else:
            self._commands.run(row.action)
