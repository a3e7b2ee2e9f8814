"""Panel with the residuals of the selected object in the shown frames."""

from __future__ import annotations

from PySide6 import QtWidgets
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor

from annotator.app.controller import Controller
from annotator.app.panels import ResidualRow, residual_rows
from annotator.app.verdicts import VerdictSettings
from annotator.qt import theme
from annotator.qt.commands import Commands
from annotator.qt.panel import Panel, fit_rows, label, number_table, tool_button


class ResidualPanel(Panel):
    """Table with one row per shown frame."""

    KINDS = ("edited", "selected", "residuals")

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__(controller)
        self.table = number_table(["frame", "edges", "chance", "depth"])
        self.table.setAccessibleName("Residuals")
        self.table.setSelectionMode(QtWidgets.QAbstractItemView.SelectionMode.NoSelection)
        self.table.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.table.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        legend = label("muted", _legend())
        legend.setWordWrap(True)
        legend.setAlignment(Qt.AlignmentFlag.AlignTop)
        scroll = QtWidgets.QScrollArea()
        scroll.setWidget(legend)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QtWidgets.QScrollArea.Shape.NoFrame)
        scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        # In a small window the legend yields, so that no other part is covered.
        scroll.setMinimumHeight(1)
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(6, 6, 6, 4)
        layout.setSpacing(4)
        layout.addWidget(tool_button(commands.actions["residuals"], labelled=True))
        layout.addWidget(self.table, 3)
        layout.addWidget(scroll, 2)
        self.follow()

    def fit_text(self) -> None:
        fit_rows(self.table)
        row = self.table.verticalHeader().defaultSectionSize()
        header = self.table.horizontalHeader().sizeHint().height()
        # The main view and three side views.
        self.table.setMinimumHeight(4 * row + header + 4)

    def refresh(self) -> None:
        c = self._controller
        rows = residual_rows(c)
        self.table.setRowCount(len(rows))
        for i, row in enumerate(rows):
            self._fill(i, row)
        self.table.setVisible(bool(rows))

    def _fill(self, i: int, row: ResidualRow) -> None:
        cells = [str(row.frame), row.edges, row.chance, row.depth]
        if row.problem:
            cells[1:] = [row.problem, "", ""]
        # Each number by its own grade: edges at chance level are grey.
        inks = (
            theme.TEXT,
            theme.look.palette.grade(row.edge_grade),
            theme.MUTED,
            theme.look.palette.grade(row.depth_grade),
        )
        for column, text in enumerate(cells):
            item = QtWidgets.QTableWidgetItem(text)
            item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
            item.setForeground(QColor(inks[column]))
            if row.problem:
                item.setToolTip(row.problem)
            self.table.setItem(i, column, item)


def _legend() -> str:
    limits = VerdictSettings.current()
    return (
        "<b>Edges</b>: median distance of the drawn contour to the nearest image edge. Up to "
        f"{limits.edge_px[0]:g} px is good, above {limits.edge_px[1]:g} px something is off.<br>"
        "<b>Chance</b>: the value for a contour at a random place nearby. Edges that are not below "
        f"{limits.chance_share:.0%} of it are not informative: check by eye there.<br>"
        "<b>Depth</b>: median of the drawn surface minus the sensor's, positive if the object lies "
        f"behind. Sensors have errors up to 2 %, so up to {limits.depth_mm[0]:g} mm may be sensor "
        "error. Only for raw and diffuse objects: on others sensor depth is wrong.<br>"
        "<b>Nearby poses</b>: 200 poses, moved by up to 30 mm and turned by up to 15 degrees, in "
        "up to eight frames. A pose fits only if it beats them."
    )
