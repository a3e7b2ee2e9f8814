"""The selected object's mesh by itself, to click points on it that the image hides."""

from __future__ import annotations

from collections.abc import Callable

from annotator.desk.controller import Controller
from annotator.desk.events import Event
from annotator.placing.standing import standing_axis
from annotator.views import ModelView
from annotator.views.meshes import ShapeStore
from annotator.web.stream import Later, StreamedPlotter
from std_toolkit.checks.palette import object_color

_POLL_S = 0.06


class MeshPicker:
    """Draws the mesh while points are clicked.

    Args:
        stream: what it is drawn into.
        shapes: shared with the other views.
        later: calls a function after some seconds.
    """

    def __init__(
        self, controller: Controller, stream: StreamedPlotter, shapes: ShapeStore, later: Later
    ) -> None:
        self._c, self._shapes, self._later = controller, shapes, later
        self._view = ModelView(stream.plotter, on_click=self._clicked, repaint=stream.repaint)
        stream.view = self._view
        self._waiting = self._closed = False
        self._unsubscribe: Callable[[], None] = controller.subscribe(self._on_event)

    def close(self) -> None:
        self._closed = True
        self._unsubscribe()
        self._view.close()

    def _refresh(self) -> None:
        c = self._c
        self._waiting = False
        if self._closed or not c.clicking:
            return
        if c.selected is None:
            self._view.show(None)
            self._view.set_points([])
        else:
            thing = c.session.object(c.selected)
            model = c.session.state.model(thing.model)
            shape = self._shapes.get(model)
            if shape is None and self._shapes.pending and not self._waiting:
                self._waiting = True
                self._later(_POLL_S, self._refresh)
            ids = [o.id for o in c.session.state.objects]
            # Where there is no shape its mesh may be what cannot be read.
            up = 2 if shape is None else standing_axis(c.session, model)
            self._view.show(shape, object_color(ids, thing.id), up=up)
            clicks = thing.clicks.get(c.active_frame, [])
            self._view.set_points([x.point for x in clicks], c.pending_point)
        self._view.draw()

    def _clicked(self, point: tuple[float, float, float]) -> None:
        c = self._c
        if c.selected is not None and c.session.writable:
            c.pending_point = point
            c.emit(Event("tool"))

    def _on_event(self, event: Event) -> None:
        if event.kind in ("edited", "selected", "tool", "frames"):
            self._refresh()
