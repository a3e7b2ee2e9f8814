"""The list of objects: colour, name, what it is made of, how far the work is, how well it fits."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import (
    QAbstractListModel,
    QMimeData,
    QModelIndex,
    QPersistentModelIndex,
    QRect,
    QRectF,
    QSize,
    Qt,
)
from PySide6.QtGui import QColor, QFont, QFontMetrics, QPainter
from PySide6.QtWidgets import QListView, QStyle, QStyledItemDelegate, QStyleOptionViewItem, QWidget

from annotator.desk.object_summary import ObjectSummary
from annotator.window import theme
from annotator.window.icons import pixmap
from std_toolkit.checks.palette import object_color

Index = QModelIndex | QPersistentModelIndex
OBJECT_MIME = "application/x-std-annotate-object"
_GRADE_INK = {
    "good": theme.GOOD,
    "fair": theme.WARNING,
    "poor": theme.BAD,
    "unknown": theme.MUTED,
}
_STATE_INK = {
    "not placed": theme.FAINT,
    "placed": theme.WARNING,
    "refined": theme.ACCENT,
    "done": theme.GOOD,
}
_ROLE = Qt.ItemDataRole


class ObjectListModel(QAbstractListModel):
    """The objects as summarized last."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[ObjectSummary] = []

    def show_rows(self, rows: list[ObjectSummary]) -> None:
        """Rows that stay keep their place, selection and scroll position."""
        if [r.id for r in rows] != [r.id for r in self.rows]:
            self.beginResetModel()
            self.rows = rows
            self.endResetModel()
        elif rows != self.rows:
            self.rows = rows
            self.dataChanged.emit(self.index(0), self.index(len(rows) - 1))

    def rowCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008
        return 0 if parent.isValid() else len(self.rows)

    def data(self, index: Index, role: int = _ROLE.DisplayRole) -> object:
        row = self.rows[index.row()]
        if role == _ROLE.DisplayRole:
            return row.name
        if role == _ROLE.ToolTipRole:
            return row.explanation
        if role == _ROLE.UserRole:
            return row
        return None

    def color(self, row: ObjectSummary) -> str:
        return object_color([r.id for r in self.rows], row.id)

    def flags(self, index: Index) -> Qt.ItemFlag:
        return super().flags(index) | Qt.ItemFlag.ItemIsDragEnabled

    def mimeTypes(self) -> list[str]:
        return [OBJECT_MIME]

    def mimeData(self, indexes: Sequence[QModelIndex]) -> QMimeData:
        data = QMimeData()
        data.setData(OBJECT_MIME, self.rows[indexes[0].row()].name.encode())
        return data


class ObjectDelegate(QStyledItemDelegate):
    """Two lines to an object."""

    def sizeHint(self, option: QStyleOptionViewItem, index: Index) -> QSize:  # noqa: ARG002
        return QSize(160, round(2.9 * QFontMetrics(option.font).height()))

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: Index) -> None:
        row: ObjectSummary = index.data(_ROLE.UserRole)
        model = index.model()
        assert isinstance(model, ObjectListModel)
        selected = bool(option.state & QStyle.StateFlag.State_Selected)
        hovered = bool(option.state & QStyle.StateFlag.State_MouseOver)
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        box: QRect = option.rect
        if selected or hovered:
            painter.fillRect(box, QColor(theme.ACCENT_DEEP if selected else theme.RAISED))
        # The object's colour, as in the views.
        color = QRectF(box.left() + 6, box.top() + 6, 6, box.height() - 12)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(model.color(row)))
        painter.drawRoundedRect(color, 2, 2)

        bold = QFont(option.font)
        bold.setWeight(QFont.Weight.DemiBold)
        small = QFont(option.font)
        small.setPointSizeF(0.88 * option.font.pointSizeF())
        half = box.height() // 2
        top = QRect(box.left() + 20, box.top() + 3, box.width() - 28, half - 2)
        bottom = QRect(top.left(), box.top() + half, top.width(), half - 3)
        right, left = Qt.AlignmentFlag.AlignRight, Qt.AlignmentFlag.AlignLeft
        middle = Qt.AlignmentFlag.AlignVCenter

        painter.setFont(small)
        used = 0
        if row.badge:
            painter.setPen(QColor(theme.TEXT if selected else _GRADE_INK[row.grade]))
            painter.drawText(bottom, right | middle, row.badge)
            used = QFontMetrics(small).horizontalAdvance(row.badge) + 8
        painter.setPen(QColor(theme.TEXT if selected else _STATE_INK[row.state]))
        painter.drawText(top, right | middle, row.state)
        word = QFontMetrics(small).horizontalAdvance(row.state) + 8

        painter.setPen(QColor(theme.TEXT if selected else theme.MUTED))
        sign = pixmap(row.material, 12, theme.TEXT if selected else theme.MUTED, 2.0)
        place = QRect(bottom.left(), bottom.center().y() - 5, 12, 12)
        painter.drawPixmap(place, sign)
        described = row.alarm or f"{row.material} · {row.model}"
        if row.alarm and not selected:
            painter.setPen(QColor(theme.BAD))
        free = bottom.adjusted(17, 0, -used, 0)
        metrics = QFontMetrics(small)
        painter.drawText(
            free,
            left | middle,
            metrics.elidedText(described, Qt.TextElideMode.ElideRight, free.width()),
        )
        painter.setFont(bold)
        painter.setPen(QColor(theme.TEXT if row.state != "not placed" or selected else theme.MUTED))
        free = top.adjusted(0, 0, -word - (18 if row.noted else 0), 0)
        name = QFontMetrics(bold).elidedText(row.name, Qt.TextElideMode.ElideRight, free.width())
        painter.drawText(free, left | middle, name)
        if row.noted:
            at = top.left() + QFontMetrics(bold).horizontalAdvance(name) + 6
            sign = pixmap("note", 12, theme.TEXT if selected else theme.WARNING, 2.0)
            painter.drawPixmap(QRect(at, top.center().y() - 6, 12, 12), sign)
        painter.restore()


class ObjectList(QListView):
    """The view of the list; objects can be dragged from it onto an image."""

    def __init__(self, model: ObjectListModel, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setModel(model)
        self.setItemDelegate(ObjectDelegate(self))
        self.setUniformItemSizes(True)
        self.setMouseTracking(True)
        self.setDragEnabled(True)
        self.setVerticalScrollMode(QListView.ScrollMode.ScrollPerPixel)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
        # Keys belong to the views: the arrows move the object, N and P go through the list.
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
