"""Separate view of the selected object's mesh, to click points on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.placing import standing_axis
from annotator.app.view_options import Style
from annotator.views.meshes import Shape, ShapeStore
from annotator.views.model_view import ModelView
from std_toolkit.html.plots import object_color

# Polling interval for a mesh that is being read, seconds.
POLL_S = 0.06


class MeshPicker:
    """Draws the mesh with its clicked points while visible.

    Args:
        plotter: target of the drawing; see `ModelView`.
        shapes: shared with the other views.
        later: calls a function after a delay in seconds.
        is_seen: returns whether the widget is visible.
        options: options of `ModelView`.
    """

    def __init__(
        self,
        controller: Controller,
        plotter: Any,
        shapes: ShapeStore,
        later: Callable[[float, Callable[[], None]], None],
        *,
        is_seen: Callable[[], bool],
        **options: Any,
    ) -> None:
        self.view = ModelView(plotter, on_click=self._clicked, **options)
        self._c, self._shapes, self._later, self._is_seen = controller, shapes, later, is_seen
        self._waiting = self._closed = False
        self._unsubscribe = controller.subscribe(self._on_event)

    def close(self) -> None:
        self._closed = True
        self._unsubscribe()
        self.view.close()

    def refresh(self) -> None:
        """Show the selected object's mesh with its points in the active view."""
        c = self._c
        if self._closed or not self._is_seen():
            return
        if c.selected is None:
            self.view.show(None)
            self.view.set_points([])
        else:
            obj = c.session.object(c.selected)
            model = c.session.state.model(obj.model)
            shape = self._shapes.get(model)
            self._wait_for(shape)
            ids = [o.id for o in c.session.state.objects]
            # Without a shape the mesh may be unreadable.
            up = 2 if shape is None else standing_axis(c.session, model)
            # A texture helps to find a point, also while the views show lines only.
            style = Style.SOLID if c.options.style is Style.SOLID else Style.TEXTURED
            self.view.show(shape, object_color(ids, obj.id), up=up, style=style)
            clicks = obj.clicks.get(c.active_frame, [])
            self.view.set_points([x.point for x in clicks], c.pending_point)
        self.view.draw()

    def _wait_for(self, shape: Shape | None) -> None:
        """Draw again when the mesh has been read, and when its colours have."""
        if not self._shapes.pending or self._waiting:
            return
        self._waiting = True

        def look_again() -> None:
            self._waiting = False
            if shape is None or not self._shapes.pending:
                self.refresh()
            elif not self._closed:
                self._wait_for(shape)

        self._later(POLL_S, look_again)

    def _clicked(self, point: tuple[float, float, float]) -> None:
        c = self._c
        if c.selected is None or not c.session.writable:
            return
        if not c.clicking:
            c.set_tool(clicking=True)
        c.pending_point = point
        c.emit(Event("tool"))

    def _on_event(self, event: Event) -> None:
        if event.kind in ("edited", "selected", "tool", "frames", "view"):
            self.refresh()
