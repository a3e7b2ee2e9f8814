"""A view with a few buttons in its corner."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QObject, QSize, Qt
from PySide6.QtWidgets import QFrame, QHBoxLayout, QToolButton, QVBoxLayout, QWidget

from annotator.desk.controller import Controller
from annotator.window import theme
from annotator.window.commands import Commands
from annotator.window.icons import icon
from annotator.window.view_widget import ViewWidget
from std_toolkit.errors import ToolkitError

_MARGIN = 6


class ViewTile(QFrame):
    """One view; the one in hand has a bright edge: keyboard steps are along its camera's axes."""

    def __init__(self, controller: Controller, commands: Commands, slot: int) -> None:
        super().__init__()
        self._controller = controller
        self.slot = slot
        self._active: bool | None = None
        self.setObjectName("tile")
        self.view = ViewWidget(self)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(1, 1, 1, 1)
        layout.addWidget(self.view)
        self.corner = QWidget(self.view)
        self.corner.setObjectName("corner")
        self.corner.setStyleSheet(
            "QWidget#corner { background: rgba(42, 42, 42, 170); border-radius: 4px; }"
            "QToolButton { padding: 2px; }"
        )
        row = QHBoxLayout(self.corner)
        row.setContentsMargins(1, 1, 1, 1)
        row.setSpacing(1)
        if slot == 0:
            for id in ("fit_view", "zoom_object"):
                button = _corner_button()
                button.setDefaultAction(commands.actions[id])
                row.addWidget(button)
        else:
            # Which frame this view looks at is chosen for it, but not once and for all.
            for by, name, tip in ((-1, "previous", "Earlier frame"), (1, "next", "Later frame")):
                button = _corner_button()
                button.setIcon(icon(name))
                button.setToolTip(f"{tip} in this view")
                button.setAutoRepeat(True)
                button.clicked.connect(lambda _=False, by=by: self._step(by))
                row.addWidget(button)
            button = _corner_button()
            button.setDefaultAction(commands.actions[f"swap_{slot}"])
            row.addWidget(button)
        self.view.installEventFilter(self)
        self.refresh()

    def refresh(self) -> None:
        """Show which view is in hand."""
        active = self._controller.active_view == self.slot
        if active is self._active:
            return
        self._active = active
        edge = theme.ACCENT if active else theme.WINDOW
        self.setStyleSheet(f"QFrame#tile {{ border: 1px solid {edge}; }}")

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self.view and event.type() == QEvent.Type.Resize:
            self.corner.adjustSize()
            self.corner.move(self.view.width() - self.corner.width() - _MARGIN, _MARGIN)
        return super().eventFilter(watched, event)

    def _step(self, by: int) -> None:
        """Another frame for this view: the next one in which objects have poses."""
        c = self._controller
        ids = list(c.session.frames)
        here = c.view_frames[self.slot]
        at = ids.index(here) if here in ids else 0
        target = ids[min(max(at + by, 0), len(ids) - 1)]
        try:
            c.show_frame(target, self.slot)
        except ToolkitError as error:
            c.tell(str(error), "error")


def _corner_button() -> QToolButton:
    button = QToolButton()
    button.setIconSize(QSize(16, 16))
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return button
