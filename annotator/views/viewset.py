"""All views of a window, with scheduling and level of detail of their rendering.

The active view is rendered immediately, the others less often. During motion, light meshes and few
points are drawn if full detail is too slow.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.view_options import Mode
from annotator.views import clouds, meshes, scene_view
from annotator.views.pointer import Pointer

Later = Callable[[float, Callable[[], None]], None]

# Time without motion after which full detail is drawn.
SETTLE_S = 0.12
# Shortest interval between updates of the inactive views during motion; they also take at most a
# third of the time.
OTHERS_EVERY_S = 0.06
OTHERS_SHARE = 3.0
# Rendering time of all views below which full detail is also drawn during motion.
FAST_S = 0.02
BLINK_S = 0.5
POLL_S = 0.04


class ViewSet:
    """The views of a controller, one for each of its `view_frames`.

    Args:
        plotters: one for each view; the first is the main one.
        later: calls a function after a delay in seconds in the front end's thread.
        clock: returns the time in seconds.
        repaint: repaints a plotter; by default a Qt widget paints itself, others render.
        pixel_ratio: physical pixels per logical one.
        background: read meshes in a thread; they appear when ready.
    """

    def __init__(
        self,
        controller: Controller,
        plotters: Sequence[Any],
        *,
        later: Later,
        clock: Callable[[], float] = time.monotonic,
        repaint: Callable[[Any], None] | None = None,
        pixel_ratio: float = 1.0,
        background: bool = True,
    ) -> None:
        self.controller = controller
        self.shapes = meshes.ShapeStore(controller.session.mesh, background=background)
        self.clouds = clouds.CloudReader(controller)
        self._later, self._clock = later, clock
        self.views = [
            scene_view.SceneView(
                plotter,
                controller,
                slot=slot,
                shapes=self.shapes,
                clouds=self.clouds,
                repaint=None if repaint is None else (lambda p=plotter: repaint(p)),  # type: ignore[misc]
                pixel_ratio=pixel_ratio,
            )
            for slot, plotter in enumerate(plotters)
        ]
        self.pointers = [
            Pointer(view, controller, motion=self, later=self._soon) for view in self.views
        ]
        self.stopwatches = [Stopwatch(view, clock) for view in self.views]
        self._last_motion = 0.0
        self._settling = False
        self._waiting: list[int] = []
        self.others_due = False
        self._others_drawn = -1e9
        self._stale: set[int] = set()
        self._blinking = False
        self._polling = self._meshes_came = False
        self._closed = False
        self._shown = _shown(controller)
        self._unsubscribe = controller.subscribe(self._on_event)
        self.draw()

    # --- drawing --------------------------------------------------------------------------------

    def draw(self, slots: Iterable[int] | None = None) -> None:
        """Draw views, default all: the active one now, the others right after."""
        wanted = list(range(len(self.views)) if slots is None else slots)
        if not self._settling:
            for slot in wanted:
                self.views[slot].moving = False
        if self._active in wanted:
            self._draw_one(self._active)
        self._queue(i for i in wanted if i != self._active)
        self._poll_shapes()

    def moved(self, view: scene_view.SceneView) -> None:
        """Handle that the eye of one view moved."""
        self._moves([view.slot])

    def end_wheels(self) -> None:
        """Commit the wheel motion of all views."""
        for pointer in self.pointers:
            pointer.end_wheel()

    def drop(
        self,
        slot: int,
        at: NDArray[np.float64],
        drop: Callable[[Controller, str, int, tuple[float, float]], object],
        what: str,
    ) -> None:
        """Handle a drop onto a view at a screen position (2,)."""
        view = self.views[slot]
        self.controller.activate_view(slot)
        drop(self.controller, what, view.frame, scene_view.recorded_pixel_under(view, at))

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._unsubscribe()
        for pointer in self.pointers:
            pointer.close()
        for watch in self.stopwatches:
            watch.close()
        for view in self.views:
            view.close()
        self.shapes.close()

    @property
    def _active(self) -> int:
        return min(self.controller.active_view, len(self.views) - 1)

    @property
    def _slow(self) -> bool:
        """Whether full detail in all views is too slow to follow the mouse."""
        return sum(t.full_s for t in self.stopwatches) > FAST_S

    def _draw_one(self, slot: int) -> None:
        if slot in self._waiting:
            self._waiting.remove(slot)
        self._stale.discard(slot)
        self.views[slot].draw()

    def _queue(self, slots: Iterable[int]) -> None:
        """Draw these views one after the other, processing mouse events in between."""
        idle = not self._waiting
        self._waiting.extend(s for s in slots if s not in self._waiting)
        if idle and self._waiting:
            self._soon(0.0, self._next)

    def _next(self) -> None:
        if self._waiting:
            self._draw_one(self._waiting[0])
        if self._waiting:
            self._soon(0.0, self._next)

    # --- moving ---------------------------------------------------------------------------------

    def _moves(self, slots: Sequence[int]) -> None:
        """Handle motion in these views."""
        self._last_motion = self._clock()
        light = self._slow
        for slot in slots:
            self.views[slot].moving = light
        first = self._active if self._active in slots else slots[0]
        self._stale.update(slots)
        self._draw_one(first)
        if self._stale and not self.others_due:
            cost = sum(self.stopwatches[i].light_s for i in self._stale)
            pause = max(OTHERS_EVERY_S, OTHERS_SHARE * cost) if light else 0.0
            self.others_due = True
            wait = self._others_drawn + pause - self._clock()
            self._soon(max(wait, 0.0), self._draw_others)
        if not self._settling:
            self._settling = True
            self._soon(SETTLE_S, self._settle)

    def _draw_others(self) -> None:
        self.others_due = False
        self._others_drawn = self._clock()
        for slot in sorted(self._stale):
            self._draw_one(slot)

    def _settle(self) -> None:
        """Draw full detail after a time without motion."""
        held = any(p.busy for p in self.pointers) or self.controller.dragging is not None
        rest = self._last_motion + SETTLE_S - self._clock()
        if held or rest > 1e-3:
            self._soon(SETTLE_S if held else rest, self._settle)
            return
        self._settling = False
        coarse = [i for i, view in enumerate(self.views) if view.moving]
        for slot in coarse:
            self.views[slot].moving = False
        if self._active in coarse:
            self._draw_one(self._active)
        self._queue(i for i in coarse if i != self._active)

    # --- events ---------------------------------------------------------------------------------

    def _on_event(self, event: Event) -> None:
        every = range(len(self.views))
        if event.kind in ("preview", "edited") and self.controller.dragging is None:
            # Cancelled by a key, or ended by another edit.
            for pointer in self.pointers:
                pointer.give_up_drag()
        if event.kind in ("preview", "edited"):
            self._moves(every)
        elif event.kind == "look":
            looking = {0, self._active} if event.text == "fit" else set(every)
            for slot in looking:
                self.views[slot].refresh(event)
            self.draw(sorted(looking))
        elif event.kind in ("frames", "view", "tool"):
            self._redraw(self._changed(event.kind))
        elif event.kind in ("selected", "penetration"):
            self._redraw(list(every))
        elif event.kind == "table" and self.controller.mode is Mode.CLOUD:
            self._redraw([0])
        if event.kind in ("edited", "view"):
            self._poll_shapes()
        if event.kind == "view" and self.controller.options.blink and not self._blinking:
            self._blinking = True
            self._soon(BLINK_S, self._blink)

    def _redraw(self, slots: list[int]) -> None:
        """Draw changed views in full detail, or light with a button held, when a drag may start."""
        if slots and any(pointer.busy for pointer in self.pointers):
            self._moves(slots)
        elif slots:
            self.draw(slots)

    def _changed(self, kind: str) -> list[int]:
        """Return the changed views; all if the options may have changed."""
        mode, frames, tool = self._shown
        now = self._shown = _shown(self.controller)
        if kind == "tool":
            # The active view or the step changed, which the views do not show.
            return [] if now[2] == tool else list(range(len(self.views)))
        if now[:2] == (mode, frames):
            return list(range(len(self.views)))
        changed = {i for i, view in enumerate(self.views) if frames[i] != view.frame}
        # The cloud shows the cameras of the other views.
        if now[0] != mode or now[0] is Mode.CLOUD:
            changed.add(0)
        return sorted(changed)

    def _blink(self) -> None:
        on = self.controller.options.blink
        off = on and not self.views[0].blinked_off and self.controller.dragging is None
        for view in self.views:
            view.blinked_off = off
        self.draw()
        self._blinking = on
        if on:
            self._soon(BLINK_S, self._blink)

    def _poll_shapes(self) -> None:
        if self.shapes.pending and not self._polling:
            self._polling = True
            self._soon(POLL_S, self._collect_shapes)

    def _collect_shapes(self) -> None:
        self._polling = False
        self._meshes_came |= self.shapes.collect()
        # Redraw once for several meshes: a full redraw for each would delay the rest.
        if self._meshes_came and not (self._waiting and self.shapes.pending):
            self._meshes_came = False
            self.draw()
        for model, error in self.shapes.problems().items():
            self.controller.tell(f"The mesh of {model} cannot be drawn: {error}", "error")
        self._poll_shapes()

    def _soon(self, seconds: float, action: Callable[[], None]) -> None:
        self._later(seconds, lambda: None if self._closed else action())


def _shown(c: Controller) -> tuple[Mode, list[int], tuple[object, ...]]:
    """Return mode, frames and tool, which events do not contain."""
    return c.mode, list(c.view_frames), (c.gizmo, c.axes, c.clicking, c.pending_point)


class Stopwatch:
    """Rendering time of a view in seconds, in full detail and during motion."""

    def __init__(self, view: scene_view.SceneView, clock: Callable[[], float]) -> None:
        self.full_s = self.light_s = 0.0
        self._view, self._clock = view, clock
        self._began = 0.0
        window = view.layers.window
        self._tags = [
            window.AddObserver("StartEvent", self._start),
            window.AddObserver("EndEvent", self._end),
        ]

    def close(self) -> None:
        for tag in self._tags:
            self._view.layers.window.RemoveObserver(tag)

    def _start(self, *_: object) -> None:
        self._began = self._clock()

    def _end(self, *_: object) -> None:
        took = self._clock() - self._began
        if self._view.moving:
            self.light_s = took
        else:
            self.full_s = took
