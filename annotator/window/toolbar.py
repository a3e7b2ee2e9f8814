"""The tool bar: the actions used most, in the order of the work."""

from __future__ import annotations

from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QHBoxLayout,
    QMainWindow,
    QSlider,
    QToolBar,
    QToolButton,
    QWidget,
)

from annotator.desk.controller import Controller
from annotator.desk.events import Event
from annotator.window.commands import Commands

# None is a line between groups; "opacity" is the slider.
ITEMS = (
    *("open", "save", None, "undo", "redo", None),
    *("mode_image", "mode_cloud", None),
    *("style_solid", "style_wireframe", "style_contour", "opacity", "blink", None),
    *("gizmo_move", "gizmo_turn", "gizmo_off", "axes", None),
    *("clicking", "refine", "drop", "residuals", None, "done"),
)
# These have their name beside the icon: they are what the window is for.
LABELLED = {
    "mode_image": "Image",
    "mode_cloud": "Cloud",
    "clicking": "Points",
    "refine": "Refine",
    "drop": "Table",
    "residuals": "Measure",
    "done": "Done",
}


class OpacitySlider(QWidget):
    """How much of the image shines through the meshes."""

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(10, 100)
        self.slider.setFixedWidth(72)
        self.setFixedWidth(80)
        self.slider.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.slider.setToolTip(
            "<b>Opacity</b> [ and ]<br>How much of the image shines through solid meshes."
        )
        self.slider.valueChanged.connect(self._set)
        row = QHBoxLayout(self)
        row.setContentsMargins(4, 0, 4, 0)
        row.addWidget(self.slider)
        self._unsubscribe = controller.subscribe(self._on_event)
        self._show()

    def close_panel(self) -> None:
        self._unsubscribe()

    def _set(self, percent: int) -> None:
        if percent != round(100 * self._controller.options.opacity):
            self._controller.set_options(opacity=percent / 100)

    def _show(self) -> None:
        self.slider.setValue(round(100 * self._controller.options.opacity))

    def _on_event(self, event: Event) -> None:
        if event.kind == "view":
            self._show()


class ActionBar(QToolBar):
    """Made from the table of actions."""

    def __init__(self, window: QMainWindow, controller: Controller, commands: Commands) -> None:
        super().__init__("Tools", window)
        self.setMovable(False)
        self.setFloatable(False)
        self.setIconSize(QSize(20, 20))
        self.toggleViewAction().setEnabled(False)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.PreventContextMenu)
        self.opacity = OpacitySlider(controller)
        self._labelled: list[QToolButton] = []
        for item in ITEMS:
            if item is None:
                self.addWidget(_line())
            elif item == "opacity":
                self.addWidget(self.opacity)
            else:
                self.addWidget(self._button(commands, item))
        self._needed = self.sizeHint().width()

    def close_panel(self) -> None:
        self.opacity.close_panel()

    def _button(self, commands: Commands, id: str) -> QToolButton:
        button = QToolButton()
        button.setIconSize(QSize(20, 20))
        button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        action = commands.actions[id]
        if id in LABELLED:
            button.setObjectName("labelled")
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
            action.setIconText(LABELLED[id])
            self._labelled.append(button)
        button.setDefaultAction(action)
        return button

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Where the names do not fit, the icons must."""
        style = Qt.ToolButtonStyle
        wanted = style.ToolButtonTextBesideIcon
        if self.width() < self._needed:
            wanted = style.ToolButtonIconOnly
        for button in self._labelled:
            button.setToolButtonStyle(wanted)
        super().resizeEvent(event)


def _line() -> QWidget:
    """A thin line between groups of buttons."""
    line = QWidget()
    line.setObjectName("line")
    line.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
    line.setFixedSize(1, 20)
    around = QWidget()
    row = QHBoxLayout(around)
    row.setContentsMargins(5, 0, 5, 0)
    row.addWidget(line)
    return around
