"""Clicked 2D-3D correspondences in a view: which pixel belongs to which point of the mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from annotator.desk.events import Event
from annotator.desk.view_options import Mode
from annotator.session import AddClick, Click
from annotator.views.captions import Captions
from annotator.views.strokes import Color, Strokes

if TYPE_CHECKING:
    from annotator.views.scene_view import SceneView

Array = NDArray[np.float64]

REACH_PX = 10.0
# Around a clicked pixel so much is left free.
_GAP_PX = 4.0
_PIXEL: Color = (1.0, 0.85, 0.2, 1.0)
_POINT: Color = (0.3, 0.95, 1.0, 1.0)
_RESIDUAL: Color = (1.0, 0.35, 0.3, 1.0)
_SHADOW: Color = (0.0, 0.0, 0.0, 0.6)


def clicks_of(view: SceneView) -> list[Click]:
    """The correspondences of the selected object in the frame of the view."""
    name = view.controller.selected
    if name is None:
        return []
    return view.controller.session.object(name).clicks.get(view.frame, [])


def pixels(view: SceneView) -> Array:
    """(N, 2) screen positions of the clicked pixels."""
    clicks = clicks_of(view)
    if not clicks:
        return np.zeros((0, 2))
    at = view.screen_of_recorded(np.array([[c.u, c.v] for c in clicks]))
    if view.dragged_marker is not None:
        index, dragged = view.dragged_marker
        at[index] = dragged
    return at


def marker_at(view: SceneView, at: Array) -> int | None:
    """Index of the clicked pixel under the pointer."""
    if view.mode is not Mode.IMAGE:
        return None
    distance = np.linalg.norm(pixels(view) - at, axis=1)
    if len(distance) == 0 or distance.min() > REACH_PX * view.pixel_ratio:
        return None
    return int(np.argmin(distance))


def pick_point(view: SceneView, at: Array) -> None:
    """The pointer is on the mesh: that point waits for its pixel."""
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


def add_pixel(view: SceneView, at: Array) -> None:
    """The pointer is on the pixel of the point that waits for it."""
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


def _beside(ends: Array, gap: float) -> Array:
    """(N, 2) from the pixels towards the points, so far that the pixels can be seen."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return along * np.divide(gap, length, out=np.ones_like(length), where=length > gap)


def draw_markers(strokes: Strokes, captions: Captions, view: SceneView) -> None:
    """The pixels, the points of the mesh as posed, and the residual between them."""
    controller, scale = view.controller, view.pixel_ratio
    name = controller.selected
    if name is None or not controller.clicking:
        return
    at = pixels(view) if view.mode is Mode.IMAGE else np.zeros((0, 2))
    pose = view.T_eye_obj(name)
    if pose is not None:
        points = np.array([c.point for c in clicks_of(view)]).reshape(-1, 3)
        seen = view.screen.project(pose @ points)
        if len(at):
            ends = np.stack([at, seen], axis=1)
            ends[:, 0] += _beside(ends, _GAP_PX * scale)
            strokes.segments(ends, 3.4 * scale, _SHADOW)
            strokes.segments(ends, 1.8 * scale, _RESIDUAL)
        for point in seen:
            strokes.disc(point, 4.6 * scale, _SHADOW)
            strokes.disc(point, 3.2 * scale, _POINT)
        if controller.pending_point is not None:
            pending = view.screen.project(pose @ np.array(controller.pending_point))
            _draw_pending(strokes, pending, scale)
    for number, pixel in enumerate(at, start=1):
        strokes.cross(pixel, 10 * scale, 3.4 * scale, _SHADOW)
        strokes.cross(pixel, 10 * scale, 1.5 * scale, _PIXEL)
        x, y = pixel
        captions.say(
            f"point {number}",
            str(number),
            (x + 8 * scale, y - 8 * scale),
            size=10.5 * scale,
            color=_PIXEL[:3],
            opacity=0.5,
            valign="bottom",
        )


def _draw_pending(strokes: Strokes, at: Array, scale: float) -> None:
    """The point that waits for its pixel."""
    strokes.ring(at, 8.5 * scale, 3.6 * scale, _SHADOW)
    strokes.ring(at, 8.5 * scale, 1.8 * scale, _PIXEL)
    strokes.disc(at, 4.6 * scale, _SHADOW)
    strokes.disc(at, 3.2 * scale, _PIXEL)
