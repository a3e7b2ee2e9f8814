"""Panels of the window that follow the controller, and the small widgets they are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar

from PySide6.QtCore import Qt
from PySide6.QtGui import QAction
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QLabel,
    QSizePolicy,
    QTableWidget,
    QToolButton,
    QWidget,
)

from annotator.app.controller import Controller
from annotator.app.events import Event, Kind


class Panel(QWidget):
    """Shows a part of the controller's state.

    Attributes:
        KINDS: kinds of the events after which it is refreshed.
    """

    KINDS: ClassVar[tuple[Kind, ...]] = ()

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self._unsubscribe: Callable[[], None] = lambda: None

    def follow(self) -> None:
        """Show the state as it is, and from now on as it changes."""
        self._unsubscribe = self._controller.subscribe(self._on_event)
        self.refresh()

    def refresh(self) -> None:
        """Show the state as it is."""

    def close_panel(self) -> None:
        """Let go of the controller."""
        self._unsubscribe()

    def _on_event(self, event: Event) -> None:
        if event.kind in self.KINDS:
            self.refresh()


def tool_button(action: QAction | None = None, *, labelled: bool = False) -> QToolButton:
    """A button that leaves the keys to the views.

    Args:
        labelled: the action's name is beside its icon.
    """
    button = QToolButton()
    if labelled:
        button.setObjectName("labelled")
        button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    if action is not None:
        button.setDefaultAction(action)
    return button


def label(name: str, text: str = "") -> QLabel:
    """A text in the style of a name: "heading", "muted" or "empty" (of a list)."""
    made = QLabel(text)
    made.setObjectName(name)
    if name == "empty":
        made.setWordWrap(True)
        made.setAlignment(Qt.AlignmentFlag.AlignCenter)
        made.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Ignored)
    return made


def number_table(titles: Sequence[str]) -> QTableWidget:
    """An empty table of rows of numbers."""
    table = QTableWidget(0, len(titles))
    table.setHorizontalHeaderLabels(list(titles))
    table.verticalHeader().setVisible(False)
    table.verticalHeader().setDefaultSectionSize(22)
    table.setShowGrid(False)
    header = table.horizontalHeader()
    header.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
    header.setHighlightSections(False)
    table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    return table
