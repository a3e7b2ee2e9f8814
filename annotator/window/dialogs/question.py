"""A question with a few named answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialog, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from annotator.desk.events import Level
from annotator.window import theme
from annotator.window.icons import pixmap

_INK = {"info": theme.ACCENT, "warning": theme.WARNING, "error": theme.BAD}


@dataclass(frozen=True)
class Answer:
    """A button.

    Attributes:
        name: what the dialog returns.
        title: what stands on the button.
        tip: what it does.
    """

    name: str
    title: str
    tip: str = ""


class Question(QDialog):
    """Asks; closing it or Esc is the last answer.

    Args:
        heading: the matter, in one line.
        text: what a person must know to decide.
        answers: the first is the usual one, the last one changes nothing.
        middle: fields between the text and the buttons.
    """

    def __init__(
        self,
        parent: QWidget | None,
        heading: str,
        text: str,
        answers: Sequence[Answer],
        *,
        level: Level = "info",
        middle: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("std-annotate")
        self.heading = heading
        self.answer = answers[-1].name
        self.buttons: dict[str, QPushButton] = {}
        sign = QLabel()
        sign.setPixmap(pixmap(level, 32, _INK[level], self.devicePixelRatioF()))
        head = QLabel(heading)
        head.setObjectName("heading")
        head.setWordWrap(True)
        self.text = QLabel(text)
        self.text.setTextFormat(Qt.TextFormat.PlainText)
        self.text.setWordWrap(True)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        words = QVBoxLayout()
        words.setSpacing(8)
        words.addWidget(head)
        words.addWidget(self.text)
        if middle is not None:
            words.addWidget(middle)
        words.addStretch(1)
        top = QHBoxLayout()
        top.setSpacing(14)
        top.addWidget(sign, 0, Qt.AlignmentFlag.AlignTop)
        top.addLayout(words, 1)
        row = QHBoxLayout()
        row.addStretch(1)
        for place, answer in enumerate(answers):
            button = QPushButton(answer.title)
            button.setToolTip(answer.tip)
            button.setDefault(place == 0)
            button.setAutoDefault(place == 0)
            button.clicked.connect(lambda _=False, name=answer.name: self._give(name))
            self.buttons[answer.name] = button
        for answer in reversed(answers):
            row.addWidget(self.buttons[answer.name])
        layout = QVBoxLayout(self)
        layout.setContentsMargins(18, 16, 18, 14)
        layout.setSpacing(14)
        layout.addLayout(top, 1)
        layout.addLayout(row)
        self.setMinimumWidth(460)
        self.buttons[answers[0].name].setFocus()

    def ask(self) -> str:
        """Show it and wait; the name of the answer."""
        self.exec()
        return self.answer

    def _give(self, name: str) -> None:
        self.answer = name
        self.accept()
