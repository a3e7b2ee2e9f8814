"""What a held button does as the pointer moves."""

from __future__ import annotations

from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from annotator.desk.view_options import Mode
from annotator.session import ChangeClick
from annotator.views.drags import Drag
from annotator.views.scene_view import SceneView

Array = NDArray[np.float64]

# The cloud turns half around as the pointer crosses the view.
ORBIT_PER_VIEW = np.pi


class Gesture(Protocol):
    """A drag under way; positions are (2,) screen positions.

    Attributes:
        moves_view: it moves the eye of this view, not the objects.
    """

    moves_view: bool

    def start(self, at: Array) -> None: ...
    def to(self, at: Array) -> None: ...
    def finish(self) -> None: ...
    def cancel(self) -> None: ...


class PoseGesture:
    """Moves an object; every view follows, and letting go makes one edit."""

    moves_view = False

    def __init__(self, view: SceneView, name: str, drag: Drag, method: str) -> None:
        self._view, self._name, self._drag, self._method = view, name, drag, method
        self._frame = view.frame
        self._T_cam_eye = view.T_eye_cam.inverse()

    def start(self, at: Array) -> None:
        pass

    def to(self, at: Array) -> None:
        T_cam_obj = self._T_cam_eye @ self._drag.to(at)
        self._view.controller.drag_to(self._name, self._frame, T_cam_obj)

    def finish(self) -> None:
        self._view.controller.end_drag(self._method)

    def cancel(self) -> None:
        self._view.controller.cancel_drag()


class _EyeGesture:
    moves_view = True

    def __init__(self, view: SceneView) -> None:
        self._view = view
        self._before = (view.eye.window, view.eye.T_eye_ref)
        self._last = np.zeros(2)

    def start(self, at: Array) -> None:
        self._last = at

    def finish(self) -> None:
        pass

    def cancel(self) -> None:
        self._view.eye.window, self._view.eye.T_eye_ref = self._before


class PanGesture(_EyeGesture):
    """Shifts the image, or the eye in the cloud; the point under the pointer stays under it."""

    def start(self, at: Array) -> None:
        super().start(at)
        self._point = self._view.point_under(at)

    def to(self, at: Array) -> None:
        view = self._view
        (dx, dy), self._last = at - self._last, at
        if view.mode is Mode.CLOUD:
            screen, depth = view.screen, float(self._point[2])
            by = np.array([dx / screen.fx, dy / screen.fy, 0.0]) * depth
            view.eye.shift(view.T_ref_cam, by)
        else:
            view.eye.pan(float(dx), float(dy), view.camera, view.size)


class OrbitGesture(_EyeGesture):
    """Goes around the selected object, or around what was grabbed."""

    def start(self, at: Array) -> None:
        super().start(at)
        self._pivot = self._view.pivot(at)

    def to(self, at: Array) -> None:
        view = self._view
        (dx, dy), self._last = at - self._last, at
        per_pixel = ORBIT_PER_VIEW / max(view.size)
        view.eye.orbit(
            view.T_ref_cam, self._pivot, view.up(), float(dx) * per_pixel, float(dy) * per_pixel
        )


class MarkerGesture:
    """Corrects the pixel of a clicked correspondence."""

    moves_view = True

    def __init__(self, view: SceneView, index: int) -> None:
        self._view, self._index = view, index

    def start(self, at: Array) -> None:
        pass

    def to(self, at: Array) -> None:
        self._view.dragged_marker = (self._index, at)

    def finish(self) -> None:
        view = self._view
        dragged, view.dragged_marker = view.dragged_marker, None
        name = view.controller.selected
        if dragged is None or name is None:
            return
        clicks = view.controller.session.object(name).clicks.get(view.frame, [])
        if self._index < len(clicks):
            u, v = view.recorded_pixel(dragged[1])
            click = msgspec.structs.replace(clicks[self._index], u=u, v=v)
            edit = ChangeClick(object=name, frame=view.frame, index=self._index, click=click)
            view.controller.apply(edit)

    def cancel(self) -> None:
        self._view.dragged_marker = None
