"""A scene of a project as a row of a list."""

from __future__ import annotations

from collections.abc import Callable

from PySide6 import QtWidgets
from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QRect, QSize, Qt
from PySide6.QtGui import QColor, QPainter, QPixmap

from annotator.app.pose_text import local_minute
from annotator.qt import theme

# What an item of the list holds: a `Card`, and a `NextTask` or None.
CARD, TASK = Qt.ItemDataRole.UserRole, Qt.ItemDataRole.UserRole + 1
_THUMB, _HEIGHT = QSize(112, 63), 79

Index = QModelIndex | QPersistentModelIndex
Reader = Callable[[str, Callable[[bytes | None], None]], None]


class SceneRows(QtWidgets.QStyledItemDelegate):
    """Draws a scene: picture, name, verdict, what is done by whom.

    Args:
        parent: repainted when a picture is there.
        read: reads the picture of a scene when it is seen, and calls a function with JPEG or None.
    """

    def __init__(self, parent: QtWidgets.QWidget, read: Reader) -> None:
        super().__init__(parent)
        self._parent, self._read = parent, read
        self._pictures: dict[str, QPixmap | None] = {}

    def sizeHint(self, option: QtWidgets.QStyleOptionViewItem, index: Index) -> QSize:  # noqa: ARG002
        return QSize(200, _HEIGHT)

    def paint(
        self, painter: QPainter, option: QtWidgets.QStyleOptionViewItem, index: Index
    ) -> None:
        card, task = index.data(CARD), index.data(TASK)
        plain = QtWidgets.QStyleOptionViewItem(option)
        self.initStyleOption(plain, index)
        plain.text = ""
        style = plain.widget.style()
        # On the colour of the chosen row, only white is legible.
        chosen = bool(plain.state & QtWidgets.QStyle.StateFlag.State_Selected)
        style.drawControl(QtWidgets.QStyle.ControlElement.CE_ItemViewItem, plain, painter)
        area = option.rect.adjusted(8, 8, -12, -8)
        image = QRect(area.topLeft(), _THUMB)
        picture = self._picture(card.name)
        if picture is None:
            painter.fillRect(image, QColor(theme.RAISED))
        else:
            painter.drawPixmap(image, picture)
        text = area.adjusted(_THUMB.width() + 12, -2, 0, 0)
        line = text.height() // 3
        who = f" by {card.people}" if card.people else ""
        what = task.task if task else card.stage
        last = card.last
        held = card.held_by
        done = f"{local_minute(last.time)}, {last.by or 'somebody'} {last.did}" if last else ""
        lines = (
            (card.name, theme.TEXT),
            (f"{what} · {card.labelled} of {card.objects} labelled{who}", theme.TEXT),
            (card.problem or held or done, theme.WARNING if held or card.problem else theme.MUTED),
        )  # fmt: skip
        for i, (words, ink) in enumerate(lines):
            font = option.font
            font.setBold(i == 0)
            painter.setFont(font)
            painter.setPen(QColor(theme.TEXT if chosen else ink))
            width = text.width() - (90 if i == 0 else 0)
            place = QRect(text.left(), text.top() + i * line, width, line)
            shown = painter.fontMetrics().elidedText(words, Qt.TextElideMode.ElideRight, width)
            painter.drawText(place, Qt.AlignmentFlag.AlignVCenter, shown)
            if i == 0:
                ink = theme.look.palette.grade(card.verdict)
                painter.setPen(QColor(theme.TEXT if chosen else ink))
                place = QRect(text.right() - 88, text.top(), 88, line)
                right = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
                painter.drawText(place, right, card.verdict or "no label")

    def _picture(self, name: str) -> QPixmap | None:
        if name not in self._pictures:
            self._pictures[name] = None

            def done(data: bytes | None) -> None:
                picture = QPixmap()
                if data and picture.loadFromData(data):
                    self._pictures[name] = picture.scaled(
                        _THUMB * self._parent.devicePixelRatioF(),
                        Qt.AspectRatioMode.KeepAspectRatioByExpanding,
                        Qt.TransformationMode.SmoothTransformation,
                    )
                    for shown in self._parent.findChildren(QtWidgets.QListWidget):
                        shown.viewport().update()

            self._read(name, done)
        return self._pictures[name]
