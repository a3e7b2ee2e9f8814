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
        rows = QtWidgets.QWidget()
        rows.setObjectName("rows")
        self._rows = QtWidgets.QScrollArea()
        self._rows.setWidget(rows)
        self._rows.setWidgetResizable(True)
        self._rows.setFrameShape(QtWidgets.QFrame.Shape.NoFrame)
        self._rows.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._rows.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._grid = QtWidgets.QGridLayout(rows)
        self._grid.setContentsMargins(0, 2, 0, 0)
        self._grid.setHorizontalSpacing(8)
        self._grid.setVerticalSpacing(2)
        self._grid.setColumnStretch(1, 1)
        card = QtWidgets.QFrame()
        card.setObjectName("card")
        self._column = column = QtWidgets.QVBoxLayout(card)
        column.setContentsMargins(8, 4, 8, 6)
        column.setSpacing(2)
        column.addLayout(top)
        for text in (self.reason, self.weak):
            text.setWordWrap(True)
            column.addWidget(text)
        column.addWidget(self._rows)
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(6, 4, 6, 2)
        layout.addWidget(card)
        self.follow()

    def fit_text(self) -> None:
        self.rows = []  # the grid keeps the size of its labels otherwise

    def fit_height(self, room: int) -> int:
        """Let the rows scroll where the card is higher than `room`; returns its height, pixels."""
        self._rows.setFixedHeight(0)
        # The outer layout would still tell the height before.
        self._column.activate()
        layout = self.layout()
        assert layout is not None
        rest = layout.heightForWidth(self.width())
        least = 2 * self.fontMetrics().height()
        needed = self._grid.totalHeightForWidth(self._rows.width())
        if needed < 0:  # no text is wrapped
            needed = self._grid.totalSizeHint().height()
        height = min(needed, max(room - rest, least))
        self._rows.setFixedHeight(height)
        return rest + height

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
        # Labels count for the height once they are shown.
        for place in range(self._grid.count()):
            if (item := self._grid.itemAt(place)) and (widget := item.widget()):
                widget.show()

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
