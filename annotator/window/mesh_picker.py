"""The selected object's mesh by itself, to click points on it that the image hides."""

from __future__ import annotations

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QVBoxLayout, QWidget

from annotator.desk.controller import Controller
from annotator.desk.events import Event
from annotator.placing.standing import standing_axis
from annotator.views import ModelView
from annotator.views.meshes import ShapeStore
from annotator.window.view_widget import ViewWidget
from std_toolkit.checks.palette import object_color

_POLL_MS = 60


class MeshPicker(QWidget):
    """Built when it is first seen: most objects are labelled without it."""

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self._shapes: ShapeStore | None = None
        self.widget: ViewWidget | None = None
        self.view: ModelView | None = None
        self._layout = QVBoxLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self.setMinimumHeight(120)
        self.setToolTip("Drag to turn the mesh, wheel to come closer, click to choose a point.")
        self._again = QTimer(self, singleShot=True, interval=_POLL_MS)
        self._again.timeout.connect(self.refresh)
        self._unsubscribe = controller.subscribe(self._on_event)

    def start(self, shapes: ShapeStore) -> None:
        """From now on meshes can be had."""
        self._shapes = shapes
        if self.isVisible():
            self._build()

    def close_panel(self) -> None:
        self._unsubscribe()
        self._again.stop()
        if self.view is not None:
            self.view.close()
        if self.widget is not None:
            self.widget.close()

    def showEvent(self, event: object) -> None:
        super().showEvent(event)  # type: ignore[arg-type]
        self._build()

    def refresh(self) -> None:
        """Show the selected object's mesh with its points in the view in hand."""
        c = self._controller
        if self.view is None or self._shapes is None or not self.isVisible():
            return
        if c.selected is None:
            self.view.show(None)
            self.view.set_points([])
        else:
            thing = c.session.object(c.selected)
            model = c.session.state.model(thing.model)
            shape = self._shapes.get(model)
            if shape is None and self._shapes.pending:
                self._again.start()
            ids = [o.id for o in c.session.state.objects]
            # Where there is no shape its mesh may be what cannot be read.
            up = 2 if shape is None else standing_axis(c.session, model)
            self.view.show(shape, object_color(ids, thing.id), up=up)
            clicks = thing.clicks.get(c.active_frame, [])
            self.view.set_points([x.point for x in clicks], c.pending_point)
        self.view.draw()

    def _build(self) -> None:
        if self.view is None and self._shapes is not None:
            self.widget = ViewWidget(self)
            self.widget.setAcceptDrops(False)
            self._layout.addWidget(self.widget)
            self.view = ModelView(
                self.widget, on_click=self._clicked, pixel_ratio=self.devicePixelRatioF()
            )
        self.refresh()

    def _clicked(self, point: tuple[float, float, float]) -> None:
        c = self._controller
        if c.selected is None or not c.session.writable:
            return
        if not c.clicking:
            c.set_tool(clicking=True)
        c.pending_point = point
        c.emit(Event("tool"))

    def _on_event(self, event: Event) -> None:
        if event.kind in ("edited", "selected", "tool", "frames"):
            self.refresh()
