"""Base class of panels that show the controller's state, and small widgets for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar

from PySide6 import QtWidgets
from PySide6.QtCore import Qt
from PySide6.QtGui import QAction

from annotator.app.controller import Controller
from annotator.app.events import Event, Kind
from annotator.qt import theme


class Panel(QtWidgets.QWidget):
    """Widget that shows a part of the controller's state.

    Attributes:
        KINDS: kinds of events that refresh it.
    """

    KINDS: ClassVar[tuple[Kind, ...]] = ()

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self._unsubscribe: Callable[[], None] = lambda: None

    def follow(self) -> None:
        """Show the state now and after every change."""
        self._unsubscribe = self._controller.subscribe(self._on_event)
        theme.look.changed.connect(self._on_look)
        self._on_look()

    def refresh(self) -> None:
        """Show the current state."""

    def close_panel(self) -> None:
        """Unsubscribe from the controller."""
        self._unsubscribe()
        theme.look.changed.disconnect(self._on_look)

    def fit_text(self) -> None:
        """Fit sizes that do not follow from the layout to the size of the text."""

    def _on_look(self) -> None:
        self.fit_text()
        self.refresh()

    def _on_event(self, event: Event) -> None:
        if event.kind in self.KINDS:
            self.refresh()


def tool_button(
    action: QAction | None = None, *, labelled: bool = False, name: str = ""
) -> QtWidgets.QToolButton:
    """Return a tool button that does not take the keyboard focus.

    Args:
        labelled: show the action's name beside its icon.
        name: what it does, if it has no action, for assistive technology.
    """
    button = QtWidgets.QToolButton()
    if labelled:
        button.setObjectName("labelled")
        button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    button.setAccessibleName(name)
    if action is not None:
        button.setDefaultAction(action)
    return button


def label(name: str, text: str = "") -> QtWidgets.QLabel:
    """Return a label with a named style: "heading", "muted" or "empty" (of a list)."""
    made = QtWidgets.QLabel(text)
    made.setObjectName(name)
    if name == "empty":
        made.setWordWrap(True)
        made.setAlignment(Qt.AlignmentFlag.AlignCenter)
        made.setSizePolicy(
            QtWidgets.QSizePolicy.Policy.Ignored, QtWidgets.QSizePolicy.Policy.Ignored
        )
    return made


def number_table(titles: Sequence[str]) -> QtWidgets.QTableWidget:
    """Return an empty table for rows of numbers."""
    table = QtWidgets.QTableWidget(0, len(titles))
    table.setHorizontalHeaderLabels(list(titles))
    table.verticalHeader().setVisible(False)
    table.setShowGrid(False)
    header = table.horizontalHeader()
    header.setSectionResizeMode(QtWidgets.QHeaderView.ResizeMode.Stretch)
    header.setHighlightSections(False)
    table.setEditTriggers(QtWidgets.QAbstractItemView.EditTrigger.NoEditTriggers)
    return table


def fit_rows(table: QtWidgets.QTableWidget) -> None:
    """Make the rows of a table as high as its text."""
    table.verticalHeader().setDefaultSectionSize(table.fontMetrics().height() + 6)
