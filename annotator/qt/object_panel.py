"""Panel with the list of objects and the settings of the selected one."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6 import QtWidgets
from PySide6.QtCore import (
    QAbstractListModel,
    QItemSelectionModel,
    QMimeData,
    QModelIndex,
    QPersistentModelIndex,
    QPoint,
    QRect,
    QRectF,
    QSize,
    Qt,
)
from PySide6.QtGui import QColor, QFont, QFontMetrics, QPainter

from annotator.app.controller import Controller
from annotator.app.object_summary import ObjectSummary, matching, progress, summarize
from annotator.qt import theme
from annotator.qt.commands import Commands
from annotator.qt.panel import Panel, label, tool_button
from annotator.qt.theme import icon, pixmap
from annotator.session import ChangeObject
from std_toolkit.html.plots import object_color
from std_toolkit.labels.entry.label import MATERIALS

_MENU = (
    ("done", "lock", "zoom_object"),
    ("rename", "note", "symmetry"),
    ("flip_x", "flip_y", "flip_z"),
    ("quarter_x", "quarter_y", "quarter_z"),
    ("unplace", "remove_object"),
)

# The view and the status line show what to do.
_EMPTY = "No objects yet."
# A list that does not fit into the panel can be searched.
_SEARCHED_FROM = 8

Index = QModelIndex | QPersistentModelIndex

OBJECT_MIME = "application/x-std-annotate-object"


# Names of the palette's colours.
_STATE_INK = {"not placed": "muted", "placed": "warning", "refined": "accent", "done": "good"}

_ROLE = Qt.ItemDataRole


class ObjectPanel(Panel):
    """Object list, material and frequent commands."""

    KINDS = ("edited", "selected", "residuals", "verdict", "penetration", "saved")

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__(controller)
        self._commands = commands
        self.model = ObjectListModel()
        self.list = ObjectList(self.model)
        self.list.setAccessibleName("Objects")
        self.list.selectionModel().currentChanged.connect(self._on_current)
        self.list.customContextMenuRequested.connect(self._show_menu)
        self.list.doubleClicked.connect(lambda: commands.run("zoom_object"))

        self.count = label("muted")
        self.search = QtWidgets.QLineEdit()
        self.search.setAccessibleName("Search objects")
        self.search.setPlaceholderText("Search: name, material, state or verdict")
        self.search.setClearButtonEnabled(True)
        self.search.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        self.search.textChanged.connect(self.refresh)
        self.search.returnPressed.connect(self.list.setFocus)
        top = QtWidgets.QHBoxLayout()
        top.addWidget(label("heading", "Objects"))
        top.addStretch(1)
        top.addWidget(self.count)

        self.stack = QtWidgets.QStackedLayout()
        self.stack.addWidget(self.list)
        self.stack.addWidget(label("empty", _EMPTY))

        self.material = QtWidgets.QComboBox()
        self.material.setAccessibleName("Material")
        self.material.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        for name in MATERIALS:
            self.material.addItem(icon(name), name)
            tip = commands.actions[f"material_{name}"].statusTip()
            self.material.setItemData(self.material.count() - 1, tip, Qt.ItemDataRole.ToolTipRole)
        self.material.setToolTip(
            "<b>Material</b><br>Sensor depth is used on raw and diffuse surfaces only."
        )
        self.material.activated.connect(self._set_material)
        below = QtWidgets.QHBoxLayout()
        below.addWidget(self.material, 1)
        for id in ("done", "lock", "note", "unplace", "remove_object"):
            below.addWidget(tool_button(commands.actions[id]))

        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(6, 4, 6, 4)
        layout.setSpacing(4)
        layout.addLayout(top)
        layout.addWidget(self.search)
        layout.addLayout(self.stack, 1)
        layout.addLayout(below)
        self.follow()

    def fit_text(self) -> None:
        self.list.setMinimumHeight(round(8.7 * self.fontMetrics().height()))
        self.list.doItemsLayout()

    def refresh(self) -> None:
        c = self._controller
        rows = summarize(c)
        self.search.setVisible(len(rows) >= _SEARCHED_FROM)
        sought = self.search.text() if self.search.isVisibleTo(self) else ""
        self.model.show_rows(matching(rows, sought), [r.id for r in rows])
        self.count.setText(progress(c))
        self.stack.setCurrentIndex(0 if rows else 1)
        names = [r.name for r in self.model.rows]
        selection = self.list.selectionModel()
        if c.selected in names:
            index = self.model.index(names.index(c.selected))
            if index != selection.currentIndex():
                flag = QItemSelectionModel.SelectionFlag.ClearAndSelect
                selection.setCurrentIndex(index, flag)
                self.list.scrollTo(index)
        else:
            selection.clear()
        if c.selected is not None:
            self.material.setCurrentText(c.session.object(c.selected).material)
        else:
            self.material.setCurrentIndex(-1)
        self.material.setEnabled(c.selected is not None and c.session.writable)

    def _on_current(self) -> None:
        index = self.list.selectionModel().currentIndex()
        if index.isValid():
            name = self.model.rows[index.row()].name
            self._controller.attempt(lambda: self._controller.select(name))

    def _set_material(self) -> None:
        c = self._controller
        material = self.material.currentText()
        if c.selected is not None and c.session.object(c.selected).material != material:
            c.apply(ChangeObject(object=c.selected, material=material))  # type: ignore[arg-type]

    def _show_menu(self, place: QPoint) -> None:
        if not self.list.indexAt(place).isValid():
            return
        menu = QtWidgets.QMenu(self)
        menu.setToolTipsVisible(True)
        for group in _MENU:
            menu.addActions([self._commands.actions[id] for id in group])
            menu.addSeparator()
        materials = menu.addMenu("Material")
        materials.addActions([self._commands.actions[f"material_{m}"] for m in MATERIALS])
        menu.popup(self.list.viewport().mapToGlobal(place))


class ObjectListModel(QAbstractListModel):
    """Qt model of the object summaries."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[ObjectSummary] = []
        self._ids: list[int] = []

    def show_rows(self, rows: list[ObjectSummary], ids: list[int]) -> None:
        """Update the rows; remaining rows keep position, selection and scroll position.

        Args:
            rows: the objects to show.
            ids: of all objects, which give the colours.
        """
        self._ids = ids
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
            # The row may cut a long name.
            return f"{row.name} ({row.model})\n{row.explanation}"
        if role == _ROLE.UserRole:
            return row
        return None

    def color(self, row: ObjectSummary) -> str:
        return object_color(self._ids, row.id)

    def flags(self, index: Index) -> Qt.ItemFlag:
        return super().flags(index) | Qt.ItemFlag.ItemIsDragEnabled

    def mimeTypes(self) -> list[str]:
        return [OBJECT_MIME]

    def mimeData(self, indexes: Sequence[QModelIndex]) -> QMimeData:
        data = QMimeData()
        data.setData(OBJECT_MIME, self.rows[indexes[0].row()].name.encode())
        return data


class ObjectDelegate(QtWidgets.QStyledItemDelegate):
    """Draws an object in two lines."""

    def sizeHint(self, option: QtWidgets.QStyleOptionViewItem, index: Index) -> QSize:  # noqa: ARG002
        return QSize(160, round(2.9 * QFontMetrics(option.font).height()))

    def paint(
        self, painter: QPainter, option: QtWidgets.QStyleOptionViewItem, index: Index
    ) -> None:
        row: ObjectSummary = index.data(_ROLE.UserRole)
        model = index.model()
        assert isinstance(model, ObjectListModel)
        selected = bool(option.state & QtWidgets.QStyle.StateFlag.State_Selected)
        hovered = bool(option.state & QtWidgets.QStyle.StateFlag.State_MouseOver)
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        box: QRect = option.rect
        if selected or hovered:
            painter.fillRect(box, QColor(theme.CHOSEN if selected else theme.RAISED))
        # Same colour as in the views.
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
            painter.setPen(
                QColor(theme.ON_CHOSEN if selected else theme.look.palette.grade(row.grade))
            )
            painter.drawText(bottom, right | middle, row.badge)
            used = QFontMetrics(small).horizontalAdvance(row.badge) + 8
        painter.setPen(QColor(theme.ON_CHOSEN if selected else _ink(row)))
        painter.drawText(top, right | middle, row.state)
        word = QFontMetrics(small).horizontalAdvance(row.state) + 8

        painter.setPen(QColor(theme.ON_CHOSEN if selected else theme.MUTED))
        sign = pixmap(row.material, 12, theme.ON_CHOSEN if selected else theme.MUTED, 2.0)
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
        ink = theme.MUTED if row.state == "not placed" else theme.TEXT
        painter.setPen(QColor(theme.ON_CHOSEN if selected else ink))
        signs = [("lock", theme.TEXT)] if row.locked else []
        signs += [("note", theme.WARNING)] if row.noted else []
        free = top.adjusted(0, 0, -word - 18 * len(signs), 0)
        name = QFontMetrics(bold).elidedText(row.name, Qt.TextElideMode.ElideRight, free.width())
        painter.drawText(free, left | middle, name)
        at = top.left() + QFontMetrics(bold).horizontalAdvance(name) + 6
        for k, (drawn, color_of) in enumerate(signs):
            sign = pixmap(drawn, 12, theme.ON_CHOSEN if selected else color_of, 2.0)
            painter.drawPixmap(QRect(at + 18 * k, top.center().y() - 6, 12, 12), sign)
        painter.restore()


def _ink(row: ObjectSummary) -> str:
    return str(getattr(theme.look.palette, _STATE_INK[row.state]))


class ObjectList(QtWidgets.QListView):
    """List view; objects can be dragged from it onto an image."""

    def __init__(self, model: ObjectListModel) -> None:
        super().__init__()
        self.setModel(model)
        self.setItemDelegate(ObjectDelegate(self))
        self.setUniformItemSizes(True)
        self.setMouseTracking(True)
        self.setDragEnabled(True)
        self.setVerticalScrollMode(QtWidgets.QListView.ScrollMode.ScrollPerPixel)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
        # No focus, so that keys reach the views: arrows move the object, N and P select another.
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
