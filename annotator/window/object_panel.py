"""The objects of the scene, and what there is to set of the selected one."""

from __future__ import annotations

from PySide6.QtCore import QItemSelectionModel, QPoint, Qt
from PySide6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QLabel,
    QMenu,
    QSizePolicy,
    QStackedLayout,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from annotator.desk.controller import Controller
from annotator.desk.events import Event
from annotator.desk.object_summary import progress, summarize
from annotator.session import ChangeObject
from annotator.window.commands import Commands
from annotator.window.icons import icon
from annotator.window.object_list import ObjectList, ObjectListModel
from std_toolkit.labels.label import MATERIALS

_MENU = (
    ("done", "zoom_object"),
    ("rename", "note", "symmetry"),
    ("flip_x", "flip_y", "flip_z"),
    ("quarter_x", "quarter_y", "quarter_z"),
    ("unplace", "remove_object"),
)
# What to do about it stands in the view and in the status line.
_EMPTY = "No objects yet."


class ObjectPanel(QWidget):
    """List, material and the most used commands."""

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__()
        self._controller = controller
        self._commands = commands
        self.model = ObjectListModel()
        self.list = ObjectList(self.model)
        self.list.selectionModel().currentChanged.connect(self._on_current)
        self.list.customContextMenuRequested.connect(self._show_menu)
        self.list.doubleClicked.connect(lambda: commands.run("zoom_object"))

        heading = QLabel("Objects")
        heading.setObjectName("heading")
        self.count = QLabel()
        self.count.setObjectName("muted")
        top = QHBoxLayout()
        top.addWidget(heading)
        top.addStretch(1)
        top.addWidget(self.count)

        empty = QLabel(_EMPTY)
        empty.setObjectName("empty")
        empty.setWordWrap(True)
        empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        empty.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Ignored)
        self.list.setMinimumHeight(round(8.7 * self.fontMetrics().height()))
        self.stack = QStackedLayout()
        self.stack.addWidget(self.list)
        self.stack.addWidget(empty)

        self.material = QComboBox()
        self.material.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        for name in MATERIALS:
            self.material.addItem(icon(name), name)
            tip = commands.actions[f"material_{name}"].statusTip()
            self.material.setItemData(self.material.count() - 1, tip, Qt.ItemDataRole.ToolTipRole)
        self.material.setToolTip(
            "<b>Material</b><br>Decides which evidence is trusted: the depth sensor is right on "
            "raw and diffuse surfaces only."
        )
        self.material.activated.connect(self._set_material)
        below = QHBoxLayout()
        below.addWidget(self.material, 1)
        for id in ("done", "note", "unplace", "remove_object"):
            button = QToolButton()
            button.setDefaultAction(commands.actions[id])
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonIconOnly)
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            below.addWidget(button)

        layout = QVBoxLayout(self)
        layout.setContentsMargins(6, 4, 6, 4)
        layout.setSpacing(4)
        layout.addLayout(top)
        layout.addLayout(self.stack, 1)
        layout.addLayout(below)
        self._unsubscribe = controller.subscribe(self._on_event)
        self.refresh()

    def close_panel(self) -> None:
        self._unsubscribe()

    def refresh(self) -> None:
        c = self._controller
        self.model.show_rows(summarize(c))
        self.count.setText(progress(c))
        self.stack.setCurrentIndex(0 if self.model.rows else 1)
        names = [r.name for r in self.model.rows]
        selection = self.list.selectionModel()
        if c.selected in names:
            index = self.model.index(names.index(c.selected))
            if index != selection.currentIndex():
                flag = QItemSelectionModel.SelectionFlag.ClearAndSelect
                selection.setCurrentIndex(index, flag)
                self.list.scrollTo(index)
            self.material.setCurrentText(c.session.object(c.selected).material)
        else:
            selection.clear()
            self.material.setCurrentIndex(-1)
        self.material.setEnabled(c.selected in names and c.session.writable)

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
        menu = QMenu(self)
        menu.setToolTipsVisible(True)
        for group in _MENU:
            menu.addActions([self._commands.actions[id] for id in group])
            menu.addSeparator()
        materials = menu.addMenu("Material")
        materials.addActions([self._commands.actions[f"material_{m}"] for m in MATERIALS])
        menu.popup(self.list.viewport().mapToGlobal(place))

    def _on_event(self, event: Event) -> None:
        if event.kind in ("edited", "selected", "residuals", "penetration", "saved"):
            self.refresh()
