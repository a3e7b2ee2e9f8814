"""The large view and the column of side views, drawn by a `ViewSet`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import QSplitter, QVBoxLayout, QWidget

from annotator.desk.controller import Controller
from annotator.desk.events import Event
from annotator.placing.placement import drop_model, drop_object
from annotator.views import ViewSet
from annotator.views.landing import recorded_pixel_under
from annotator.views.meshes import ShapeStore
from annotator.window.commands import Commands
from annotator.window.view_tile import ViewTile

SIDE_WIDTH = 260


class ViewArea(QWidget):
    """All views of a scene.

    Attributes:
        tiles: the main view first.
    """

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__()
        self._controller = controller
        self.tiles = [
            ViewTile(controller, commands, slot) for slot in range(len(controller.view_frames))
        ]
        self.column = QSplitter(Qt.Orientation.Vertical)
        for tile in self.tiles[1:]:
            self.column.addWidget(tile)
        self.split = QSplitter(Qt.Orientation.Horizontal)
        self.split.addWidget(self.tiles[0])
        if len(self.tiles) > 1:
            self.split.addWidget(self.column)
        self.split.setStretchFactor(0, 1)
        self.split.setStretchFactor(1, 0)
        self.split.setSizes([10_000, SIDE_WIDTH])
        for split in (self.split, self.column):
            split.setHandleWidth(3)
            split.setChildrenCollapsible(False)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.split)
        for tile in self.tiles:
            tile.view.model_dropped.connect(
                lambda id, x, y, slot=tile.slot: self._drop(drop_model, id, slot, x, y)
            )
            tile.view.object_dropped.connect(
                lambda name, x, y, slot=tile.slot: self._drop(drop_object, name, slot, x, y)
            )
        self.views: ViewSet | None = None
        self._unsubscribe = controller.subscribe(self._on_event)

    def start(self) -> ShapeStore:
        """Build the views, whose widgets stand in the window by now; returns their meshes."""
        ratio = self.devicePixelRatioF()
        plotters = [tile.view for tile in self.tiles]
        self.views = ViewSet(self._controller, plotters, later=self.later, pixel_ratio=ratio)
        return self.views.shapes

    def close_panel(self) -> None:
        self._unsubscribe()
        if self.views is not None:
            self.views.close()
        for tile in self.tiles:
            tile.view.close()

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        """Call a function in this thread after a while, unless the views are gone by then."""
        QTimer.singleShot(round(1000 * seconds), self, call)

    def _drop(self, drop: Callable[..., bool], what: str, slot: int, x: float, y: float) -> None:
        if self.views is not None:
            view = self.views.views[slot]
            self._controller.activate_view(slot)
            uv = recorded_pixel_under(view, np.array([x, y]))
            drop(self._controller, what, view.frame, uv)

    def _on_event(self, event: Event) -> None:
        if event.kind in ("frames", "tool", "view", "edited"):
            for tile in self.tiles:
                tile.refresh()
