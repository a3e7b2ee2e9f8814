"""Questions as Qt dialogs, and the dialogs of a workspace."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from PySide6 import QtWidgets
from PySide6.QtCore import QObject, Qt
from PySide6.QtGui import QKeySequence

from annotator.app import command_palette, dialogs, events, questions
from annotator.app.controller import Controller
from annotator.app.palette import stepped
from annotator.qt import command_list, settings, theme
from annotator.qt.graphics import renderer_name
from annotator.qt.theme import pixmap
from std_toolkit.geometry.mesh import MESH_SUFFIXES

_COLUMNS = 3


class WindowDialogs(QObject):
    """Shows the dialogs requested by the actions of one controller.

    Args:
        parent: window over which they appear.
        own: dialogs implemented by the window, by name.
    """

    def __init__(
        self,
        parent: QtWidgets.QWidget,
        controller: Controller,
        own: dict[str, Callable[[], object]],
    ) -> None:
        super().__init__(parent)
        self._parent = parent
        self._controller = controller
        self._dialogs = dialogs.Dialogs(
            controller,
            self._show,
            own={
                **own,
                **look_dialogs(controller),
                "add_mesh": self._browse_meshes,
                "commands": self._find_command,
            },
            drawn_by=lambda: renderer_name() or "an unknown renderer",
        )
        self.add_meshes = self._dialogs.add_meshes
        controller.subscribe(self._on_event)

    def _on_event(self, event: events.Event) -> None:
        if event.kind == "ask":
            self._dialogs.ask(event.text)

    def _show(self, question: questions.Question | None) -> None:
        if question is None:
            return
        dialog = QuestionDialog(self._parent, question)
        if question.groups:  # a table is modeless
            dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
            dialog.show()
        else:
            self._dialogs.answer(question.number, *dialog.ask())

    def _find_command(self) -> None:
        row = command_list.CommandList(self._parent.window(), self._controller).ask()
        if row is not None:
            c = self._controller
            c.attempt(lambda: command_palette.run(c, row.kind, row.target))

    def _browse_meshes(self) -> None:
        kinds = " ".join(f"*{s}" for s in MESH_SUFFIXES)
        names, _ = QtWidgets.QFileDialog.getOpenFileNames(
            self._parent, "Add mesh", "", f"Meshes ({kinds})"
        )
        self.add_meshes([Path(n) for n in names])


def look_dialogs(controller: Controller) -> dict[str, Callable[[], object]]:
    """Return the actions that change what the window looks like, by name."""
    look = theme.look
    controller.light = look.light

    def change(*, light: bool, text: int) -> None:
        app = QtWidgets.QApplication.instance()
        assert isinstance(app, QtWidgets.QApplication)
        look.apply(app, light=light, text=text)
        settings.remember_look(light=light, text=text)
        controller.light = light
        controller.emit(events.Event("view"))

    def resize(steps: int) -> None:
        text = stepped(look.text, steps)
        change(light=look.light, text=text)
        controller.tell(f"Text size: {text} %.")

    return {
        "light_theme": lambda: change(light=not look.light, text=look.text),
        "larger_text": lambda: resize(1),
        "smaller_text": lambda: resize(-1),
    }


class QuestionDialog(QtWidgets.QDialog):
    """Dialog of a question; closing it or Esc cancels, unless it must be answered.

    Attributes:
        buttons: by the button's id.
        widgets: editors of the fields, by name.
    """

    def __init__(self, parent: QtWidgets.QWidget | None, question: questions.Question) -> None:
        super().__init__(parent)
        self.setWindowTitle("std-annotate")
        self.heading = question.title
        self._question = question
        self._pressed = ""
        self.buttons: dict[str, QtWidgets.QPushButton] = {}
        self.widgets = {field.name: _editor(field) for field in question.fields}
        top = QtWidgets.QHBoxLayout()
        top.setSpacing(14)
        if not question.groups:
            sign = QtWidgets.QLabel()
            ratio = self.devicePixelRatioF()
            sign.setPixmap(
                pixmap(question.level, 32, theme.look.palette.level(question.level), ratio)
            )
            top.addWidget(sign, 0, Qt.AlignmentFlag.AlignTop)
        top.addLayout(self._words(), 1)
        row = QtWidgets.QHBoxLayout()
        row.addStretch(1)
        for place, button in reversed(list(enumerate(question.buttons))):
            widget = self.buttons[button.id] = QtWidgets.QPushButton(button.text)
            widget.setToolTip(button.tip)
            widget.setDefault(place == 0)
            widget.setAutoDefault(place == 0)
            widget.clicked.connect(lambda _=False, id=button.id: self._press(id))
            row.addWidget(widget)
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(18, 16, 18, 14)
        layout.setSpacing(14)
        layout.addLayout(top, 1)
        layout.addLayout(row)
        self.setMinimumWidth(460)
        if question.groups:
            self.resize(1180, 720)
        first = next(iter(self.widgets.values()), self.buttons[question.buttons[0].id])
        first.setFocus()
        if isinstance(first, QtWidgets.QLineEdit):
            first.selectAll()

    def ask(self) -> tuple[str, questions.Answers]:
        """Show it and wait; returns the id of the button ("" if cancelled) and the answers."""
        self.exec()
        return self._pressed, self.answers()

    def answers(self) -> questions.Answers:
        """Return the values of the fields, by name."""
        return {name: _value(widget) for name, widget in self.widgets.items()}

    def reject(self) -> None:
        if not self._question.must_answer:
            super().reject()

    def _press(self, id: str) -> None:
        self._pressed = id
        self.accept()

    def _enable(self, form: QtWidgets.QFormLayout) -> None:
        """Enable only the fields that apply."""
        answers = self.answers()
        for field in self._question.fields:
            widget = self.widgets[field.name]
            for part in (widget, form.labelForField(widget)):
                if part is not None:
                    part.setEnabled(field.is_asked(answers))

    def _words(self) -> QtWidgets.QVBoxLayout:
        head = QtWidgets.QLabel(self.heading)
        head.setObjectName("heading")
        head.setWordWrap(True)
        self.text = QtWidgets.QLabel(self._question.text)
        self.text.setTextFormat(Qt.TextFormat.PlainText)
        self.text.setWordWrap(True)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.text.setVisible(bool(self._question.text))
        words = QtWidgets.QVBoxLayout()
        words.setSpacing(8)
        words.addWidget(head)
        words.addWidget(self.text)
        form = QtWidgets.QFormLayout()
        form.setContentsMargins(0, 4, 0, 0)
        for field in self._question.fields:
            widget = self.widgets[field.name]
            widget.setToolTip(field.tip)
            widget.setAccessibleName(field.label)
            if field.kind in ("line", "number"):
                form.addRow(field.label, widget)
            elif field.kind == "lines":
                form.addRow(QtWidgets.QLabel(field.label))
                form.addRow(widget)
            else:  # switches and choices contain their labels
                form.addRow(widget)
        for widget in self.widgets.values():
            for button in widget.findChildren(QtWidgets.QRadioButton) or [widget]:
                if isinstance(button, QtWidgets.QAbstractButton):
                    button.toggled.connect(lambda _: self._enable(form))
        self._enable(form)
        words.addLayout(form)
        if self._question.groups:
            self.tables = GroupTables(self._question.groups, searchable=self._question.searchable)
            words.addWidget(self.tables, 1)
        else:
            words.addStretch(1)
        return words


class GroupTables(QtWidgets.QWidget):
    """Read-only tables in columns of similar height, with a search field."""

    def __init__(self, groups: Sequence[questions.Group], *, searchable: bool) -> None:
        super().__init__()
        self._groups = [
            (g.heading, [(_native(r[0], g.keys), r[1]) for r in g.rows]) for g in groups
        ]
        self.search = QtWidgets.QLineEdit()
        self.search.setPlaceholderText("Search")
        self.search.setAccessibleName("Search")
        self.search.setClearButtonEnabled(True)
        self.search.textChanged.connect(self._show)
        self.search.setVisible(searchable)
        self.columns = [QtWidgets.QLabel() for _ in range(_COLUMNS)]
        row = QtWidgets.QHBoxLayout()
        row.setSpacing(28)
        for column in self.columns:
            column.setTextFormat(Qt.TextFormat.RichText)
            column.setAlignment(Qt.AlignmentFlag.AlignTop)
            column.setWordWrap(True)
            row.addWidget(column, 1)
        body = QtWidgets.QWidget()
        body.setLayout(row)
        scroll = QtWidgets.QScrollArea()
        scroll.setWidget(body)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QtWidgets.QScrollArea.Shape.NoFrame)
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.search)
        layout.addWidget(scroll, 1)
        self._show("")

    def rows(self, wanted: str = "") -> dict[str, list[tuple[str, str]]]:
        """Return the rows that contain `wanted`, by heading."""
        wanted = wanted.lower()
        return {
            heading: found
            for heading, rows in self._groups
            if (found := [r for r in rows if wanted in " ".join(r).lower()])
        }

    def _show(self, wanted: str) -> None:
        groups = self.rows(wanted)
        # Groups are kept whole and in order.
        total = sum(len(rows) + 2 for rows in groups.values())
        texts = [""] * _COLUMNS
        filled, at = 0, 0
        for heading, rows in groups.items():
            if filled + (len(rows) + 2) / 2 > (at + 1) * total / _COLUMNS and at < _COLUMNS - 1:
                at += 1
            texts[at] += _table(heading, rows)
            filled += len(rows) + 2
        for column, text in zip(self.columns, texts, strict=True):
            column.setText(text)


def _editor(field: questions.Field) -> Any:
    if field.kind == "line":
        return QtWidgets.QLineEdit(str(field.value))
    if field.kind == "lines":
        editor = QtWidgets.QPlainTextEdit(str(field.value))
        editor.setTabChangesFocus(True)
        editor.setFixedHeight(110)
        return editor
    if field.kind == "number":
        number = QtWidgets.QSpinBox()
        number.setMaximumWidth(140)
        number.setRange(field.least, field.most)
        number.setSuffix(f" {field.unit}" if field.unit else "")
        number.setValue(int(field.value))
        return number
    if field.kind == "switch":
        switch = QtWidgets.QCheckBox(field.label)
        switch.setChecked(bool(field.value))
        return switch
    choices = QtWidgets.QWidget()
    column = QtWidgets.QVBoxLayout(choices)
    column.setContentsMargins(0, 0, 0, 0)
    group = QtWidgets.QButtonGroup(choices)
    for choice in field.choices:
        button = QtWidgets.QRadioButton(choice.text)
        button.setProperty("choice", choice.value)
        button.setChecked(choice.value == field.value)
        group.addButton(button)
        column.addWidget(button)
    return choices


def _value(widget: Any) -> str | int | bool:
    if isinstance(widget, QtWidgets.QLineEdit):
        return widget.text()
    if isinstance(widget, QtWidgets.QPlainTextEdit):
        return widget.toPlainText()
    if isinstance(widget, QtWidgets.QSpinBox):
        return widget.value()
    if isinstance(widget, QtWidgets.QCheckBox):
        return widget.isChecked()
    chosen = widget.findChild(QtWidgets.QButtonGroup).checkedButton()
    return str(chosen.property("choice"))


def _native(text: str, keys: bool) -> str:
    """Return keys in the notation of the system; other text unchanged."""
    native = QKeySequence.SequenceFormat.NativeText
    if not keys:
        return text
    return " or ".join(QKeySequence(key).toString(native) for key in text.split(" or "))


def _table(heading: str, rows: list[tuple[str, str]]) -> str:
    cells = "".join(
        f"<tr><td style='color:{theme.ACCENT}; padding:1px 12px 1px 0; white-space:nowrap'>"
        f"{escape(key)}</td><td style='padding:1px 0'>{escape(what)}</td></tr>"
        for key, what in rows
    )
    return f"<p style='margin:10px 0 2px 0'><b>{heading}</b></p><table>{cells}</table>"
