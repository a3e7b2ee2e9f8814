"""Panel of 2D-3D correspondences: a mesh to click on and the list of clicked points."""

from __future__ import annotations

from PySide6 import QtWidgets
from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QColor, QShowEvent

from annotator.app.controller import Controller
from annotator.app.panels import ClickRow, ClickSettings, click_rows
from annotator.qt import theme
from annotator.qt.commands import Commands
from annotator.qt.panel import Panel, fit_rows, label, number_table, tool_button
from annotator.qt.theme import icon
from annotator.qt.view_area import ViewWidget
from annotator.session import ChangeClick, Click
from annotator.views import ModelView
from annotator.views.mesh_picker import MeshPicker
from annotator.views.meshes import ShapeStore

_EMPTY = (
    "No points yet.\n\nClick a point on the mesh above, then the same point in the image. "
    "Four or more points give the pose; spread them over the object."
)


class PointsPanel(Panel):
    """Clicked points of the selected object, with their residuals."""

    KINDS = ("edited", "selected", "frames", "tool")

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__(controller)
        self.rows: list[ClickRow] = []
        self._filling = False
        self.table = number_table(["#", "frame", "u", "v", "residual"])
        self.table.setAccessibleName("Clicked points")
        header = self.table.horizontalHeader()
        header.setSectionResizeMode(0, QtWidgets.QHeaderView.ResizeMode.ResizeToContents)
        self.table.setSelectionBehavior(QtWidgets.QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.setSelectionMode(QtWidgets.QAbstractItemView.SelectionMode.SingleSelection)
        self.table.setEditTriggers(QtWidgets.QAbstractItemView.EditTrigger.DoubleClicked)
        self.table.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        self.table.itemChanged.connect(self._on_typed)
        self.table.itemSelectionChanged.connect(self._update_buttons)
        self.table.setToolTip(
            "Pixels of the recorded image; the residual is the reprojection error.<br>Drag a cross "
            "in the image to correct it, or double-click a number here."
        )

        below = QtWidgets.QWidget()
        self.stack = QtWidgets.QStackedLayout(below)
        self.stack.addWidget(self.table)
        self.stack.addWidget(label("empty", _EMPTY))

        self.remove_button = QtWidgets.QPushButton(icon("remove"), "Delete point")
        self.remove_button.setToolTip("Delete the selected point.")
        self.remove_button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.remove_button.clicked.connect(self.remove)
        buttons = QtWidgets.QHBoxLayout()
        for id in ("clicking", "solve_points"):
            buttons.addWidget(tool_button(commands.actions[id], labelled=True))
        buttons.addStretch(1)
        edit = QtWidgets.QHBoxLayout()
        edit.addWidget(self.remove_button)
        edit.addStretch(1)

        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(6, 6, 6, 4)
        layout.setSpacing(4)
        layout.addLayout(buttons)
        self.picker = MeshPickerWidget(controller)
        layout.addWidget(self.picker, 3)
        layout.addWidget(below, 2)
        layout.addLayout(edit)
        self.follow()

    def close_panel(self) -> None:
        super().close_panel()
        self.picker.close_panel()

    def selected_row(self) -> ClickRow | None:
        chosen = self.table.selectionModel().selectedRows()
        return self.rows[chosen[0].row()] if chosen else None

    def correct(self, row: ClickRow, column: int, text: str) -> None:
        """Set a pixel coordinate from typed text."""
        name = self._controller.selected
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            self._controller.tell(f"{text!r} is not a pixel coordinate.", "warning")
            self.refresh()
            return
        if name is not None and (
            (column == 1 and value != row.u) or (column == 2 and value != row.v)
        ):
            old = self._controller.session.object(name).clicks[row.frame][row.number]
            u, v = (value, row.v) if column == 2 else (row.u, value)
            click = Click(u=u, v=v, point=old.point)
            edit = ChangeClick(object=name, frame=row.frame, index=row.number, click=click)
            if not self._controller.apply(edit):
                self.refresh()

    def _on_typed(self, item: QtWidgets.QTableWidgetItem) -> None:
        if not self._filling and item.column() in (2, 3):
            self.correct(self.rows[item.row()], item.column(), item.text())

    def remove(self) -> None:
        """Delete the selected point."""
        row, name = self.selected_row(), self._controller.selected
        if row is not None and name is not None:
            edit = ChangeClick(object=name, frame=row.frame, index=row.number, click=None)
            self._controller.apply(edit)

    def fit_text(self) -> None:
        fit_rows(self.table)

    def refresh(self) -> None:
        c = self._controller
        self.rows = [] if c.selected is None else click_rows(c, c.selected)
        self._filling = True
        self.table.setRowCount(len(self.rows))
        for i, row in enumerate(self.rows):
            residual = "" if row.residual_px is None else f"{row.residual_px:.1f} px"
            for column, text in enumerate(
                (str(row.number + 1), str(row.frame), f"{row.u:.1f}", f"{row.v:.1f}", residual)
            ):
                item = QtWidgets.QTableWidgetItem(text)
                item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                if column == 4 and row.residual_px is not None:
                    item.setForeground(QColor(_ink(row.residual_px)))
                if column not in (2, 3) or not c.session.writable:
                    item.setFlags(item.flags() & ~Qt.ItemFlag.ItemIsEditable)
                self.table.setItem(i, column, item)
        self._filling = False
        self.stack.setCurrentIndex(0 if self.rows else 1)
        self._update_buttons()

    def _update_buttons(self) -> None:
        c = self._controller
        usable = self.selected_row() is not None and c.session.writable
        self.remove_button.setEnabled(usable)


def _ink(residual_px: float) -> str:
    limits = ClickSettings.current()
    if residual_px <= limits.good_px:
        return theme.GOOD
    return theme.WARNING if residual_px <= limits.bad_px else theme.BAD


class MeshPickerWidget(QtWidgets.QWidget):
    """Mesh view, built when first shown, because most objects are labelled without it."""

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self._shapes: ShapeStore | None = None
        self._picker: MeshPicker | None = None
        self.widget: ViewWidget | None = None
        self._layout = QtWidgets.QVBoxLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self.setMinimumHeight(120)
        self.setToolTip("Drag to rotate the mesh, scroll to zoom, click to select a point.")

    @property
    def view(self) -> ModelView | None:
        return None if self._picker is None else self._picker.view

    def start(self, shapes: ShapeStore) -> None:
        """Provide the meshes."""
        self._shapes = shapes
        if self.isVisible():
            self._build()

    def close_panel(self) -> None:
        if self._picker is not None:
            self._picker.close()
        if self.widget is not None:
            self.widget.close()

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self._build()

    def _build(self) -> None:
        if self._shapes is None:
            return
        if self._picker is None:
            self.widget = ViewWidget(self)
            self.widget.setAcceptDrops(False)
            self._layout.addWidget(self.widget)
            self._picker = MeshPicker(
                self._controller,
                self.widget,
                self._shapes,
                lambda seconds, call: QTimer.singleShot(round(1000 * seconds), self, call),
                is_seen=self.isVisible,
                pixel_ratio=self.devicePixelRatioF(),
            )
        self._picker.refresh()
