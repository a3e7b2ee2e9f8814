"""Overlay of a view: handles, clicked points, cameras, names and hints."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from annotator.app.controller import Controller
from annotator.app.view_options import CloudSource, Gizmo, Mode
from annotator.session import Click
from annotator.views import cloud_layer, gizmo, layers, solids, viewpoint
from annotator.views.strokes import Color, Strokes, rgba
from std_toolkit.html.plots import object_color

# Arrow length: fraction of the drawing area, smallest and largest value.
GIZMO_SHARE, SMALLEST_GIZMO_PX, LARGEST_GIZMO_PX = 0.16, 38.0, 92.0

_CAMERA: Color = (0.93, 0.86, 0.62, 0.9)

_WARNING = (0.98, 0.78, 0.35)


ScreenPoints = NDArray[np.float64]


# Free radius around a clicked pixel.
_GAP_PX = 4.0


_PIXEL: Color = (1.0, 0.85, 0.2, 1.0)


_POINT: Color = (0.3, 0.95, 1.0, 1.0)


_RESIDUAL: Color = (1.0, 0.35, 0.3, 1.0)


_SHADOW: Color = (0.0, 0.0, 0.0, 0.6)


class OverlaidView(viewpoint.Viewpoint, ABC):
    """View with an overlay.

    Attributes:
        pixel_ratio: physical pixels per logical one.
        hovered, held: handles under the pointer and being dragged.
        dragged_marker: index of the clicked pixel being dragged, and its current position.
        problem: text on why there is no image or cloud.
    """

    def __init__(
        self, controller: Controller, *, slot: int, size: tuple[int, int], pixel_ratio: float
    ) -> None:
        super().__init__(controller, slot=slot, size=size)
        self.pixel_ratio = pixel_ratio
        self.hovered: gizmo.Handle | None = None
        self.held: gizmo.Handle | None = None
        self.dragged_marker: tuple[int, ScreenPoints] | None = None
        self.problem = ""

    @abstractmethod
    def solid(self, name: str | None) -> solids.Solid | None:
        """Return an object as drawn here; None if its mesh is not available yet."""

    def gizmo_frame(self) -> gizmo.GizmoFrame | None:
        """Return the handles of the selected object; None if there are none."""
        controller = self.controller
        hidden = controller.gizmo is Gizmo.OFF or controller.clicking or controller.options.hidden
        solid = self.solid(controller.selected)
        if hidden or solid is None or solid.T_eye_obj is None or not controller.session.writable:
            return None
        T_eye_obj = solid.T_eye_obj
        centre = T_eye_obj @ solid.shape.centre
        if centre[2] < 0.02 or controller.session.object(str(controller.selected)).locked:
            return None
        axes = T_eye_obj.R if controller.axes == "object" else self.T_eye_cam.R
        largest = LARGEST_GIZMO_PX * self.pixel_ratio
        size = float(np.clip(GIZMO_SHARE * min(self.size), SMALLEST_GIZMO_PX, largest))
        return gizmo.GizmoFrame(self.screen, centre, axes, size, self.up())


def draw_overlay(strokes: Strokes, captions: layers.Captions, view: OverlaidView) -> None:
    """Draw the overlay over image, cloud and meshes."""
    if view.mode is Mode.CLOUD:
        _draw_cameras(strokes, captions, view)
    frame = view.gizmo_frame()
    if frame is not None:
        gizmo.draw_gizmo(
            strokes,
            frame,
            view.controller.gizmo,
            hovered=view.hovered,
            only=view.held,
            scale=view.pixel_ratio,
        )
    draw_markers(strokes, captions, view)
    _say_captions(captions, view)


def _draw_cameras(strokes: Strokes, captions: layers.Captions, view: OverlaidView) -> None:
    """Draw the cameras of the frames of the views."""
    T_eye_world = view.T_eye_world
    session, scale = view.controller.session, view.pixel_ratio
    if T_eye_world is None:
        return
    for frame in dict.fromkeys(view.controller.view_frames):
        T_world_cam = session.T_world_cam(frame)
        if T_world_cam is None:
            continue
        camera = session.scene.camera(session.scene.frame(frame)).without_distortion()
        at = cloud_layer.draw_camera(
            strokes, view.screen, T_eye_world @ T_world_cam, camera, _CAMERA, scale=scale
        )
        if at is not None:
            x, y = at
            captions.say(
                f"camera {frame}",
                str(frame),
                (x, y - 6 * scale),
                size=11 * scale,
                color=_CAMERA[:3],
                opacity=0.4,
                align="center",
                valign="bottom",
            )


def _say_captions(captions: layers.Captions, view: OverlaidView) -> None:
    """Show the frame, the name of the selected object, and missing data."""
    session, scale = view.controller.session, view.pixel_ratio
    frame = session.scene.frame(view.frame)
    name = "" if frame.name == f"{frame.id:06d}" else f"  {frame.name}"
    text = f"Frame {frame.id}{name}"
    color = layers.FAINT
    if session.posed and session.T_world_cam(view.frame) is None:
        text, color = f"{text}  ·  no camera pose", _WARNING
    elif view.mode is Mode.CLOUD:
        text += f"  ·  {'points of many frames' if _fused(view) else 'points of this frame'}"
    captions.say("frame", text, (8 * scale, 8 * scale), size=12 * scale, color=color)
    _say_name(captions, view)
    width, height = view.size
    if view.problem:
        captions.say(
            "problem",
            _wrapped(view.problem, width / scale),
            (width / 2, height / 2 if view.mode is Mode.IMAGE else height - 40 * scale),
            size=14 * scale,
            align="center",
            valign="center",
            opacity=0.8,
        )
    elif view.slot == 0 and not session.state.objects:
        captions.say(
            "empty",
            _first_step(view),
            (width / 2, height - 60 * scale),
            size=14 * scale,
            align="center",
            valign="bottom",
            opacity=0.8,
        )


def _first_step(view: OverlaidView) -> str:
    """Return a hint for a scene without objects."""
    session = view.controller.session
    if not session.writable:
        return "No objects"
    if not session.state.models:
        return "No objects yet\nAdd the CAD mesh of each object with Ctrl+M."
    return "No objects yet\nDrag a mesh from the library onto the image, or double-click it."


def _say_name(captions: layers.Captions, view: OverlaidView) -> None:
    """Show the selected object's name above it."""
    controller, scale = view.controller, view.pixel_ratio
    name = controller.selected
    solid = view.solid(name)
    if name is None or solid is None or solid.T_eye_obj is None:
        return
    seen = view.screen.project(solid.T_eye_obj @ solid.shape.corners)
    if not np.isfinite(seen).all():
        return
    x = float(np.clip(seen[:, 0].mean(), 30 * scale, view.size[0] - 30 * scale))
    y = float(np.clip(seen[:, 1].min() - 8 * scale, 40 * scale, view.size[1] - 10 * scale))
    ids = [o.id for o in controller.session.state.objects]
    color = rgba(object_color(ids, controller.session.object(name).id))
    captions.say(
        "name",
        name,
        (x, y),
        size=12 * scale,
        paper=_darker(color),
        opacity=0.85,
        align="center",
        valign="bottom",
    )


def _fused(view: OverlaidView) -> bool:
    return view.controller.options.cloud is CloudSource.FUSED and view.controller.session.posed


def _darker(color: Color) -> tuple[float, float, float]:
    """Return the colour mixed with the background colour, so that white text is readable on it."""
    r, g, b = (0.55 * c + 0.45 * p for c, p in zip(color[:3], layers.PAPER, strict=True))
    return r, g, b


def _wrapped(text: str, width: float) -> str:
    """Wrap a text to about the width in logical pixels."""
    import textwrap

    letters = max(int(width / 9), 20)
    return "\n".join(
        line for part in text.split("\n") for line in textwrap.wrap(part, letters) or [""]
    )


def clicks_of(view: OverlaidView) -> list[Click]:
    """Return the correspondences of the selected object in the frame of the view."""
    name = view.controller.selected
    if name is None:
        return []
    return view.controller.session.object(name).clicks.get(view.frame, [])


def pixels(view: OverlaidView) -> ScreenPoints:
    """Return (N, 2) screen positions of the clicked pixels."""
    clicks = clicks_of(view)
    if not clicks:
        return np.zeros((0, 2))
    at = view.screen_of_recorded(np.array([[c.u, c.v] for c in clicks]))
    if view.dragged_marker is not None:
        index, dragged = view.dragged_marker
        at[index] = dragged
    return at


def _beside(ends: ScreenPoints, gap: float) -> ScreenPoints:
    """Return (N, 2) line starts, displaced from the pixels so that the pixels stay visible."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return along * np.divide(gap, length, out=np.ones_like(length), where=length > gap)


def draw_markers(strokes: Strokes, captions: layers.Captions, view: OverlaidView) -> None:
    """Draw the pixels, the projected mesh points, and the residuals between them."""
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


def _draw_pending(strokes: Strokes, at: ScreenPoints, scale: float) -> None:
    """Draw the pending point."""
    strokes.ring(at, 8.5 * scale, 3.6 * scale, _SHADOW)
    strokes.ring(at, 8.5 * scale, 1.8 * scale, _PIXEL)
    strokes.disc(at, 4.6 * scale, _SHADOW)
    strokes.disc(at, 3.2 * scale, _PIXEL)
