"""List of all commands, objects and frames, searched by typing and run by keys."""

from __future__ import annotations

from PySide6 import QtWidgets
from PySide6.QtCore import QEvent, QObject, QSize, Qt
from PySide6.QtGui import QKeyEvent, QKeySequence, QPainter

from annotator.app import command_palette
from annotator.app.command_palette import Command
from annotator.app.controller import Controller
from annotator.qt import theme

_ROLE = Qt.ItemDataRole
_MOVES = (Qt.Key.Key_Up, Qt.Key.Key_Down, Qt.Key.Key_PageUp, Qt.Key.Key_PageDown)


class CommandList(QtWidgets.QDialog):
    """Dialog of the commands; Return runs the marked one, Esc closes it.

    Attributes:
        chosen: the command to run after it was closed, or None.
    """

    def __init__(self, parent: QtWidgets.QWidget, controller: Controller) -> None:
        super().__init__(parent)
        self._controller = controller
        self.chosen: Command | None = None
        self.setWindowTitle("Find a command")
        self.search = QtWidgets.QLineEdit()
        self.search.setPlaceholderText("Command, object, mesh or frame")
        self.search.setAccessibleName("Command, object, mesh or frame")
        self.search.textChanged.connect(self._fill)
        self.search.returnPressed.connect(self._run)
        self.search.installEventFilter(self)
        self.list = QtWidgets.QListWidget()
        self.list.setAccessibleName("Commands found")
        self.list.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.list.setUniformItemSizes(True)
        self.list.setItemDelegate(_Rows(self.list))
        self.list.itemClicked.connect(self._run)
        self.list.currentRowChanged.connect(self._tell)
        self.tip = QtWidgets.QLabel()
        self.tip.setWordWrap(True)
        self.tip.setMinimumHeight(2 * self.fontMetrics().height() + 4)
        self.tip.setAlignment(Qt.AlignmentFlag.AlignTop)
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(10, 10, 10, 8)
        for part in (self.search, self.list, self.tip):
            layout.addWidget(part)
        room = parent.size()
        wanted = QSize(round(6.2 * theme.look.text), round(4.6 * theme.look.text))
        self.resize(wanted.boundedTo(room - QSize(40, 40)))
        self._fill("")
        self.search.setFocus()

    @property
    def rows(self) -> list[Command]:
        """The commands that are listed."""
        return [self.list.item(i).data(_ROLE.UserRole) for i in range(self.list.count())]

    def ask(self) -> Command | None:
        """Show it and wait; returns the command to run, or None."""
        self.exec()
        return self.chosen

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Let the keys that move the mark do so while the field has the focus."""
        if isinstance(event, QKeyEvent) and event.key() in _MOVES:
            if event.type() == QEvent.Type.KeyPress:
                QtWidgets.QApplication.sendEvent(self.list, event)
            return True
        return super().eventFilter(watched, event)

    def _fill(self, typed: str) -> None:
        self.list.clear()
        for row in command_palette.commands(self._controller, typed):
            item = QtWidgets.QListWidgetItem(row.title)
            item.setData(_ROLE.UserRole, row)
            why = f", not now: {row.problem}" if row.problem else ""
            item.setData(_ROLE.AccessibleTextRole, f"{row.title}, {row.where}, {row.keys}{why}")
            self.list.addItem(item)
        self.list.setCurrentRow(0)
        self._tell()

    def _current(self) -> Command | None:
        item = self.list.currentItem()
        return None if item is None else item.data(_ROLE.UserRole)

    def _tell(self) -> None:
        row = self._current()
        text = "Nothing has this name." if row is None else row.tip
        if row is not None and row.problem:
            text = f"Not now: {row.problem}."
        self.tip.setText(text)
        theme.set_ink(self.tip, "warning" if row is not None and row.problem else "muted")

    def _run(self) -> None:
        row = self._current()
        if row is not None and not row.problem:
            self.chosen = row
            self.accept()


class _Rows(QtWidgets.QStyledItemDelegate):
    """Draws a command: its title at the left, its menu and keys at the right."""

    def sizeHint(self, option: QtWidgets.QStyleOptionViewItem, index: object) -> QSize:  # noqa: ARG002
        return QSize(200, round(1.6 * option.fontMetrics.height()))

    def paint(
        self, painter: QPainter, option: QtWidgets.QStyleOptionViewItem, index: object
    ) -> None:
        row: Command = index.data(_ROLE.UserRole)  # type: ignore[attr-defined]
        marked = bool(option.state & QtWidgets.QStyle.StateFlag.State_Selected)
        box = option.rect
        if marked:
            painter.fillRect(box, theme.CHOSEN)
        place = box.adjusted(8, 0, -8, 0)
        middle = Qt.AlignmentFlag.AlignVCenter
        native = QKeySequence.SequenceFormat.NativeText
        keys = " or ".join(
            QKeySequence(key).toString(native) for key in row.keys.split(" or ") if key
        )
        right = f"{row.where}   {keys}" if keys else row.where
        painter.setPen(theme.ON_CHOSEN if marked else theme.MUTED)
        painter.drawText(place, Qt.AlignmentFlag.AlignRight | middle, right)
        free = place.adjusted(0, 0, -option.fontMetrics.horizontalAdvance(right) - 12, 0)
        usual = theme.FAINT if row.problem else theme.TEXT
        painter.setPen(theme.ON_CHOSEN if marked else usual)
        title = option.fontMetrics.elidedText(row.title, Qt.TextElideMode.ElideRight, free.width())
        painter.drawText(free, Qt.AlignmentFlag.AlignLeft | middle, title)
