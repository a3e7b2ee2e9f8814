"""Interactor events of a plotter, and gestures that move objects, the eye or clicked points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray
from vtkmodules.vtkInteractionStyle import vtkInteractorStyleUser

from annotator.app.events import Event
from annotator.app.view_options import Mode
from annotator.session import AddClick, ChangeClick, Click
from annotator.views import drags
from annotator.views.overlay import ScreenPoints, pixels
from annotator.views.scene_view import SceneView

REACH_PX = 10.0

Array = NDArray[np.float64]

# Rotation of the cloud when the pointer crosses the view, radians.
ORBIT_PER_VIEW = np.pi


def marker_at(view: SceneView, at: ScreenPoints) -> int | None:
    """Return the index of the clicked pixel under the pointer, or None."""
    if view.mode is not Mode.IMAGE:
        return None
    distance = np.linalg.norm(pixels(view) - at, axis=1)
    if len(distance) == 0 or distance.min() > REACH_PX * view.pixel_ratio:
        return None
    return int(np.argmin(distance))


def pick_point(view: SceneView, at: ScreenPoints) -> None:
    """Set the mesh point under the pointer as the pending point of a correspondence."""
    controller = view.controller
    name = controller.selected
    if name is None:
        controller.tell("Select an object first.", "warning")
        return
    picked = view.objects.pick_on(view, name, at)
    if picked is None:
        controller.tell(f"Click a point on the mesh of {name} first.", "warning")
        return
    controller.pending_point = (float(picked[0]), float(picked[1]), float(picked[2]))
    controller.emit(Event("tool"))


def add_pixel(view: SceneView, at: ScreenPoints) -> None:
    """Add a correspondence of the pending point and the pixel under the pointer."""
    controller = view.controller
    name, point = controller.selected, controller.pending_point
    if name is None or point is None:
        return
    if view.mode is not Mode.IMAGE:
        controller.tell("Pixels are clicked in an image: press Tab.", "warning")
        return
    u, v = view.recorded_pixel(at)
    camera = view.recorded_camera
    if not (-0.5 <= u <= camera.width - 0.5 and -0.5 <= v <= camera.height - 0.5):
        controller.tell("Click inside the image.", "warning")
        return
    click = Click(u=u, v=v, point=list(point))
    controller.pending_point = None
    controller.apply(AddClick(object=name, frame=view.frame, click=click))


class Gesture(Protocol):
    """Current drag; positions are (2,) screen positions.

    Attributes:
        moves_view: whether it moves the eye of this view instead of objects.
    """

    moves_view: bool

    def start(self, at: Array) -> None: ...
    def to(self, at: Array) -> None: ...
    def finish(self) -> None: ...
    def cancel(self) -> None: ...


class PoseGesture:
    """Moves an object in all views; the release commits one edit."""

    moves_view = False

    def __init__(self, view: SceneView, name: str, drag: drags.Drag, method: str) -> None:
        self._view, self._name, self._drag, self._method = view, name, drag, method
        self._frame = view.frame
        self._T_cam_eye = view.T_eye_cam.inverse()

    def start(self, at: Array) -> None:
        del at
        self._view.controller.may_move(self._name)

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
    """Pans the image, or the eye in the cloud; the point under the pointer stays under it."""

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
    """Orbits the selected object, or the grabbed point."""

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
    """Moves the pixel of a clicked correspondence."""

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


def interactor_of(plotter: Any) -> Any:
    """Return the VTK interactor of a pyvista plotter or Qt widget."""
    return plotter.iren.interactor


class Events:
    """Observers of a plotter's interactor, which replace all default mouse and key handlers.

    The default styles of VTK and pyvista rotate the camera and have key bindings: w changes the
    representation, q closes.
    """

    def __init__(self, plotter: Any, handlers: dict[str, Callable[..., None]]) -> None:
        self.interactor = interactor_of(plotter)
        style: Any = vtkInteractorStyleUser()
        style.AddObserver("CharEvent", lambda *_: None)
        # pyvista restores its own style after a double click, so this style must replace it there.
        plotter.iren.style = style
        # The interactor does not hold a Python reference to the style.
        self._style = style
        plotter.iren.clear_key_event_callbacks()
        self._tags = [self.interactor.AddObserver(e, h) for e, h in handlers.items()]

    def close(self) -> None:
        for tag in self._tags:
            self.interactor.RemoveObserver(tag)
