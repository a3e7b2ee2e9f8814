"""Qt actions from the table of actions: menus, tool bar and shortcuts."""

from __future__ import annotations

from PySide6 import QtWidgets
from PySide6.QtCore import QEvent, QObject, QSize, Qt, QTimer
from PySide6.QtGui import QAction, QKeyEvent, QKeySequence, QResizeEvent

from annotator.app.action import Action
from annotator.app.action_table import ACTIONS, MENUS, OPACITY_TIP, SHORT_TITLES, TOOLS
from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.qt import number_field, panel, theme

TEXT_FIELDS = (
    QtWidgets.QLineEdit,
    QtWidgets.QAbstractSpinBox,
    QtWidgets.QPlainTextEdit,
    QtWidgets.QTextEdit,
)


class Commands(QObject):
    """All actions as `QAction`s of one window, synchronized with the controller.

    Attributes:
        actions: by the action's id.
        menus: by name, submenus as "Object/Flip".
    """

    def __init__(self, window: QtWidgets.QMainWindow, controller: Controller) -> None:
        super().__init__(window)
        self._controller = controller
        self._window = window
        self._items = {a.id: a for a in ACTIONS}
        self.actions: dict[str, QAction] = {a.id: self._made(a) for a in ACTIONS}
        self.menus: dict[str, QtWidgets.QMenu] = {}
        self._moving = False
        self._soon = QTimer(self, singleShot=True, interval=0)
        self._soon.timeout.connect(self.update)
        self._unsubscribe = controller.subscribe(self._on_event)
        self.update()

    def close(self) -> None:
        self._unsubscribe()
        self._soon.stop()
        for action in self.actions.values():
            self._window.removeAction(action)

    def update(self) -> None:
        """Update enabled state, check mark and title of all actions from the controller."""
        for id, action in self.actions.items():
            item = self._items[id]
            action.setEnabled(item.enabled(self._controller))
            if item.checked is not None:
                action.setChecked(item.checked(self._controller))
            if item.label is not None:
                action.setText(item.label(self._controller))

    def run(self, id: str) -> None:
        """Run an action if it is enabled; the menu may be slightly out of date."""
        item = self._items[id]
        if item.enabled(self._controller):
            self._controller.attempt(lambda: item.run(self._controller))
        # Qt toggles the mark of a checkable action itself, even if the action failed.
        self._soon.start()

    def fill_menu_bar(self) -> None:
        """Fill the menus of the window; entries of a group are adjacent."""
        bar = self._window.menuBar()
        bar.clear()
        for name in MENUS:
            menu = bar.addMenu(name)
            self.menus[name] = menu
            self._fill_menu(menu, [a for a in ACTIONS if a.menu == name])

    def _fill_menu(self, menu: QtWidgets.QMenu, items: list[Action]) -> None:
        menu.setToolTipsVisible(True)
        for group in dict.fromkeys(a.group for a in items):
            members = [self.actions[a.id] for a in items if a.group == group]
            if group[:1].isupper():
                submenu = self.menus[f"{menu.title()}/{group}"] = menu.addMenu(group)
                submenu.setToolTipsVisible(True)
                submenu.addActions(members)
            else:
                if not menu.isEmpty():
                    menu.addSeparator()
                menu.addActions(members)

    def _made(self, item: Action) -> QAction:
        action = QAction(theme.icon(item.id), item.title, self._window)
        action.setShortcuts([QKeySequence(key) for key in item.keys])
        # Shortcuts work wherever the focus is in the window.
        action.setShortcutContext(Qt.ShortcutContext.WindowShortcut)
        action.setAutoRepeat(item.repeats)
        keys = " or ".join(QKeySequence(k).toString(_NATIVE) for k in item.keys)
        action.setToolTip(f"<b>{item.title}</b>{f' &nbsp;{keys}' if keys else ''}<br>{item.tip}")
        action.setStatusTip(item.tip)
        action.setCheckable(item.checked is not None)
        action.setMenuRole(QAction.MenuRole.NoRole)
        action.triggered.connect(lambda _=False, id=item.id: self.run(id))
        self._window.addAction(action)
        return action

    def _on_event(self, event: Event) -> None:
        moving = self._controller.dragging is not None
        # A drag can be undone, so only its start and end change the actions.
        begins_or_ends = event.kind == "preview" and moving != self._moving
        self._moving = moving
        if begins_or_ends or event.kind not in ("preview", "message", "look"):
            self._soon.start()


_NATIVE = QKeySequence.SequenceFormat.NativeText


class TypingGuard(QObject):
    """Event filter that keeps keys typed into a field from triggering shortcuts.

    Qt lets the focused widget override shortcuts. Fields claim letters but neither page keys nor
    Tab, which would then reach the window.
    """

    def __init__(self, app: QtWidgets.QApplication) -> None:
        super().__init__(app)
        app.focusChanged.connect(self._on_focus)

    def _on_focus(self, old: QtWidgets.QWidget | None, new: QtWidgets.QWidget | None) -> None:
        if isinstance(old, TEXT_FIELDS):
            old.removeEventFilter(self)
        if isinstance(new, TEXT_FIELDS):
            new.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            if not _is_command(event):
                event.accept()
                return True
            if isinstance(watched, number_field.NumberField) and not watched.edited:
                # Nothing was typed: undo applies to the edit, not to the text.
                event.ignore()
                return True
        return super().eventFilter(watched, event)


def _is_command(event: QKeyEvent) -> bool:
    """Whether a key is always a command: with Ctrl or Alt, or a function key."""
    if Qt.Key.Key_F1 <= event.key() <= Qt.Key.Key_F12:
        return True
    strong = Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.AltModifier
    return bool(event.modifiers() & strong)


class OpacitySlider(panel.Panel):
    """Slider for the opacity of the meshes."""

    KINDS = ("view",)

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self.slider = QtWidgets.QSlider(Qt.Orientation.Horizontal)
        self.slider.setAccessibleName("Opacity")
        self.slider.setRange(10, 100)
        self.slider.setFixedWidth(72)
        self.setFixedWidth(80)
        self.slider.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.slider.setToolTip(f"<b>Opacity</b> [ and ]<br>{OPACITY_TIP}")
        self.slider.valueChanged.connect(self._set)
        row = QtWidgets.QHBoxLayout(self)
        row.setContentsMargins(4, 0, 4, 0)
        row.addWidget(self.slider)
        self.follow()

    def _set(self, percent: int) -> None:
        if percent != round(100 * self._controller.options.opacity):
            self._controller.set_options(opacity=percent / 100)

    def refresh(self) -> None:
        self.slider.setValue(round(100 * self._controller.options.opacity))


class ActionBar(QtWidgets.QToolBar):
    """Tool bar built from the table of actions."""

    def __init__(
        self, window: QtWidgets.QMainWindow, controller: Controller, commands: Commands
    ) -> None:
        super().__init__("Tools", window)
        self.setMovable(False)
        self.setFloatable(False)
        self.setIconSize(QSize(20, 20))
        self.toggleViewAction().setEnabled(False)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.PreventContextMenu)
        self.opacity = OpacitySlider(controller)
        self._labelled: list[QtWidgets.QToolButton] = []
        for place, group in enumerate(TOOLS):
            if place:
                self.addWidget(_line())
            for id in group:
                widget = self.opacity if id == "opacity" else self._button(commands, id)
                self.addWidget(widget)
        self._needed = self.sizeHint().width()
        theme.look.changed.connect(self._fit_text)

    def close_panel(self) -> None:
        theme.look.changed.disconnect(self._fit_text)
        self.opacity.close_panel()

    def _button(self, commands: Commands, id: str) -> QtWidgets.QToolButton:
        action = commands.actions[id]
        button = panel.tool_button(action, labelled=id in SHORT_TITLES)
        button.setIconSize(QSize(20, 20))
        if id in SHORT_TITLES:
            action.setIconText(SHORT_TITLES[id])
            self._labelled.append(button)
        return button

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Show icons only if the names do not fit."""
        self._show_names(self.width() >= self._needed)
        super().resizeEvent(event)

    def _show_names(self, shown: bool) -> None:
        style = Qt.ToolButtonStyle
        wanted = style.ToolButtonTextBesideIcon if shown else style.ToolButtonIconOnly
        for button in self._labelled:
            button.setToolButtonStyle(wanted)

    def _fit_text(self) -> None:
        self._show_names(True)
        self._needed = self.sizeHint().width()
        self._show_names(self.width() >= self._needed)


def _line() -> QtWidgets.QWidget:
    """Return a thin line between groups of buttons."""
    line = QtWidgets.QWidget()
    line.setObjectName("line")
    line.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
    line.setFixedSize(1, 20)
    around = QtWidgets.QWidget()
    row = QtWidgets.QHBoxLayout(around)
    row.setContentsMargins(5, 0, 5, 0)
    row.addWidget(line)
    return around
