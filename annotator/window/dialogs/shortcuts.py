"""All keys and what the mouse does, made from the table of actions."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtWidgets import (
    QDialog,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from annotator.actions import ACTIONS, MENUS, Action
from annotator.actions.mouse import MOUSE
from annotator.window import theme

_COLUMNS = 3


class ShortcutSheet(QDialog):
    """A sheet that stays open beside the work, with a field to search it."""

    def __init__(self, parent: QWidget | None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Keys and mouse")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.search = QLineEdit()
        self.search.setPlaceholderText("Search")
        self.search.setClearButtonEnabled(True)
        self.search.textChanged.connect(self._show)
        self.columns = [QLabel() for _ in range(_COLUMNS)]
        row = QHBoxLayout()
        row.setSpacing(28)
        for column in self.columns:
            column.setTextFormat(Qt.TextFormat.RichText)
            column.setAlignment(Qt.AlignmentFlag.AlignTop)
            column.setWordWrap(True)
            row.addWidget(column, 1)
        body = QWidget()
        body.setLayout(row)
        scroll = QScrollArea()
        scroll.setWidget(body)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QScrollArea.Shape.NoFrame)
        layout = QVBoxLayout(self)
        layout.addWidget(self.search)
        layout.addWidget(scroll, 1)
        self.resize(1180, 720)
        self._show("")

    def rows(self, wanted: str = "") -> dict[str, list[tuple[str, str]]]:
        """Keys (or gestures) and what they do, by menu; those that hold `wanted`."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for menu in MENUS:
            items = [a for a in ACTIONS if a.menu == menu and a.keys]
            groups[menu] = [(keys_of(a), a.title) for a in items]
        groups["Mouse"] = [(m.gesture, m.effect) for m in MOUSE]
        wanted = wanted.lower()
        return {
            name: found
            for name, rows in groups.items()
            if (found := [r for r in rows if wanted in f"{r[0]} {r[1]}".lower()])
        }

    def _show(self, wanted: str) -> None:
        groups = self.rows(wanted)
        # Columns of about the same height, groups kept whole and in order.
        total = sum(len(rows) + 2 for rows in groups.values())
        texts = [""] * _COLUMNS
        filled, at = 0, 0
        for name, rows in groups.items():
            if filled + (len(rows) + 2) / 2 > (at + 1) * total / _COLUMNS and at < _COLUMNS - 1:
                at += 1
            texts[at] += _table(name, rows)
            filled += len(rows) + 2
        for column, text in zip(self.columns, texts, strict=True):
            column.setText(text)


def keys_of(action: Action) -> str:
    """Its keys as the system writes them."""
    native = QKeySequence.SequenceFormat.NativeText
    return " or ".join(QKeySequence(k).toString(native) for k in action.keys)


def _table(name: str, rows: list[tuple[str, str]]) -> str:
    cells = "".join(
        f"<tr><td style='color:{theme.ACCENT}; padding:1px 12px 1px 0; white-space:nowrap'>"
        f"{_escaped(key)}</td><td style='padding:1px 0'>{_escaped(what)}</td></tr>"
        for key, what in rows
    )
    return f"<p style='margin:10px 0 2px 0'><b>{name}</b></p><table>{cells}</table>"


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")
