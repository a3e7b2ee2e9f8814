"""Workspace of one open scene: views, panels, tool bar and status line."""

from __future__ import annotations

from PySide6.QtCore import QPoint, Qt, QTimer, Signal
from PySide6.QtGui import QKeyEvent, QResizeEvent
from PySide6.QtWidgets import (
    QAbstractSpinBox,
    QApplication,
    QLineEdit,
    QMainWindow,
    QSplitter,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from annotator.app.background_updates import BackgroundUpdates
from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.qt import (
    commands,
    evidence_panel,
    frame_bar,
    library_panel,
    messages,
    object_panel,
    points_panel,
    pose_panel,
    residual_panel,
    settings,
    theme,
    view_area,
)

SIDE_WIDTH = 300
UPKEEP_AFTER_MS = 500


class Workspace(QWidget):
    """Central widget of the window while a scene is open.

    Signals:
        files_dropped: mesh files (list of Path) dropped onto the library or a view.
    """

    files_dropped = Signal(list)

    def __init__(self, window: QMainWindow, controller: Controller) -> None:
        super().__init__(window)
        self.controller = controller
        self._window = window
        self._closed = False
        self._upkeep: BackgroundUpdates | None = None
        self.commands = commands.Commands(window, controller)
        self.commands.fill_menu_bar()
        self.toolbar = commands.ActionBar(window, controller, self.commands)
        window.addToolBar(Qt.ToolBarArea.TopToolBarArea, self.toolbar)

        self.views = view_area.ViewArea(controller, self.commands)
        self.banner = messages.Banner(self.views)
        self.frame_bar = frame_bar.FrameBar(controller, self.commands)
        self.status = messages.StatusLine(controller)
        self.objects = object_panel.ObjectPanel(controller, self.commands)
        self.library = library_panel.LibraryPanel(controller, self.commands)
        self.pose = pose_panel.PosePanel(controller, self.commands)
        self.points = points_panel.PointsPanel(controller, self.commands)
        self.evidence = evidence_panel.EvidencePanel(controller, self.commands)
        self.residuals = residual_panel.ResidualPanel(controller, self.commands)
        self.tabs = QTabWidget()
        self.tabs.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.tabs.tabBar().setFocusPolicy(Qt.FocusPolicy.NoFocus)
        for page in (self.library, self.points, self.residuals):
            # Large size hints of hidden pages must not limit the others.
            page.setMinimumHeight(1)
        self.tabs.addTab(self.library, "Meshes")
        self.tabs.addTab(self.pose, "Pose")
        self.tabs.addTab(self.points, "Points")
        self.tabs.addTab(self.residuals, "Residuals")

        # The verdict is the first thing that is seen of an object.
        self.inspector = QWidget()
        stacked = QVBoxLayout(self.inspector)
        stacked.setContentsMargins(0, 0, 0, 0)
        stacked.setSpacing(2)
        stacked.addWidget(self.evidence)
        stacked.addWidget(self.tabs, 1)

        left = QWidget()
        column = QVBoxLayout(left)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(2)
        column.addWidget(self.views, 1)
        column.addWidget(self.frame_bar)
        self.side = QSplitter(Qt.Orientation.Vertical)
        for panel in (self.objects, self.inspector):
            self.side.addWidget(panel)
        self.side.setChildrenCollapsible(False)
        self.side.splitterMoved.connect(self._keep_side)
        self.tabs.currentChanged.connect(self._share_side)
        # The card changes its height with what it says.
        self._soon = QTimer(self, singleShot=True, interval=0)
        self._soon.timeout.connect(self._share_side)
        theme.look.changed.connect(self._fit_text)
        self._fit_text()
        self.split = QSplitter(Qt.Orientation.Horizontal)
        self.split.addWidget(left)
        self.split.addWidget(self.side)
        self.split.setStretchFactor(0, 1)
        self.split.setStretchFactor(1, 0)
        self.split.setSizes([10_000, SIDE_WIDTH])
        self.split.setChildrenCollapsible(False)
        for split in (self.side, self.split):
            split.setHandleWidth(4)
        # Until the user moves a splitter, each panel gets its preferred size.
        self._shared = True
        known = settings.restore_splitters(self.splitters)
        if "side" in known:
            self._shared = False
        self.views.own_widths = "views" in known
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(self.split, 1)
        layout.addWidget(self.status)

        self.library.files_dropped.connect(self.files_dropped)
        for tile in self.views.tiles:
            tile.view.files_dropped.connect(self.files_dropped)
        self.pose.left.connect(self.focus_views)
        self.frame_bar.left.connect(self.focus_views)
        placed = any(o.placements for o in controller.session.state.objects)
        self.tabs.setCurrentWidget(self.pose if placed else self.library)
        self._unsubscribe = controller.subscribe(self._on_event)

    @property
    def splitters(self) -> dict[str, QSplitter]:
        """Return the splitters that the user can move, by name."""
        return {
            "panels": self.split,
            "side": self.side,
            "views": self.views.split,
            "column": self.views.column,
        }

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._share_side()

    def _share_side(self) -> None:
        total = self.side.height()
        least = self.objects.minimumSizeHint().height()
        current = self.tabs.currentWidget()
        # Lists of meshes, points and frames can shrink; the pose panel has a fixed size.
        page = _needed(current) if current is self.pose else round(0.4 * total)
        page += self.tabs.tabBar().height() + 8
        card = 0
        if self.evidence.isVisible():
            card = self.evidence.fit_height(total - least - page)
        if not self._shared:
            return
        objects = max(least, total - card - page)
        self.side.setSizes([objects, max(total - objects, 1)])

    def _fit_text(self) -> None:
        self.side.setMinimumWidth(round((SIDE_WIDTH - 40) * theme.look.text / 100))
        self._soon.start()

    def _keep_side(self) -> None:
        self._shared = False

    def start(self) -> None:
        """Build the views, and start background updates."""
        self.points.picker.start(self.views.start())
        self.focus_views()
        # Start after the first image is shown.
        QTimer.singleShot(UPKEEP_AFTER_MS, self, self._start_upkeep)

    def _start_upkeep(self) -> None:
        if not self._closed:
            self.library.draw_pictures()
            self._upkeep = BackgroundUpdates(self.controller)

    def focus_views(self) -> None:
        """Move the keyboard focus to the active view."""
        self.views.tiles[self.controller.active_view].view.setFocus()

    def next_field(self) -> None:
        """Give the keys to the next field of the panels that is shown; after the last, to the view.

        Without any, the numbers of the pose are shown.
        """
        fields = self._fields()
        if not fields:
            self.tabs.setCurrentWidget(self.pose)
            fields = self._fields()
        focus = QApplication.focusWidget()
        place = next((k for k, field in enumerate(fields) if field is focus), -1)
        if place + 1 < len(fields):
            fields[place + 1].setFocus(Qt.FocusReason.TabFocusReason)
        else:
            self.focus_views()

    def _fields(self) -> list[QWidget]:
        found = [
            field
            for kind in (QAbstractSpinBox, QLineEdit)
            for field in self.side.findChildren(kind)
            if field.isVisible() and field.isEnabled()
            and not isinstance(field.parent(), QAbstractSpinBox)
        ]  # fmt: skip
        corner = QPoint()
        return sorted(found, key=lambda f: f.mapTo(self.side, corner).toTuple()[::-1])

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Esc leads from a field back to the views."""
        if event.key() == Qt.Key.Key_Escape and QApplication.focusWidget() in self._fields():
            self.focus_views()
        else:
            super().keyPressEvent(event)

    def close_panel(self) -> None:
        """Unsubscribe from the controller; the widgets are deleted afterwards."""
        self._closed = True
        theme.look.changed.disconnect(self._fit_text)
        self._soon.stop()
        settings.remember(self._window, self._divided())
        self._unsubscribe()
        if self._upkeep is not None:
            self._upkeep.close()
        for panel in (
            self.views, self.frame_bar, self.status, self.objects, self.library, self.pose,
            self.points, self.evidence, self.residuals, self.toolbar,
        ):  # fmt: skip
            panel.close_panel()
        self.commands.close()
        self._window.removeToolBar(self.toolbar)
        self.toolbar.deleteLater()
        self._window.menuBar().clear()

    def _divided(self) -> dict[str, QSplitter]:
        """Return the splitters whose layout is stored: those that a person has moved."""
        left_out = {"side"} if self._shared else set()
        if not self.views.own_widths:
            left_out |= {"views"}
        if self.controller.options.maximised:
            left_out |= {"views", "column"}
        return {name: s for name, s in self.splitters.items() if name not in left_out}

    def _on_event(self, event: Event) -> None:
        if event.kind == "message":
            self.banner.notices.tell(event.text, event.level)
        elif event.kind == "tool" and self.controller.clicking:
            self.tabs.setCurrentWidget(self.points)
        if event.kind in self.evidence.KINDS:
            self._soon.start()


def _needed(panel: QWidget) -> int:
    """Height of a panel whose texts are wrapped at its width."""
    layout = panel.layout()
    assert layout is not None
    return max(layout.heightForWidth(panel.width()), layout.sizeHint().height())
