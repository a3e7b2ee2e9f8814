"""Gizmo: geometry and drawing of handles that move and rotate an object along axes.

Pure geometry: a pinhole (`ScreenCamera`), a centre and axes in eye coordinates, screen positions.
`pointer.py` handles the mouse.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from annotator.app.view_options import Gizmo
from annotator.views import drags
from annotator.views.projection import ScreenCamera
from annotator.views.strokes import Color, Strokes
from std_toolkit.geometry import SE3

__all__ = ["ARROW_START", "AXIS_COLORS", "HOVERED", "draw_gizmo"]

Array = NDArray[np.float64]

# Fractions of the gizmo's size: start of the arrows, disc, the two outermost rings.
ARROW_START, DISC, YAW_RING, VIEW_RING = 0.26, 0.16, 1.1, 1.22

# An arrow foreshortened below this fraction points at the eye and cannot be dragged.
SHORTEST_ARROW = 0.3

# Motion of a depth handle for one pixel of the pointer, in pixels at the object's depth.
DEPTH_GAIN = 2.0

REACH_PX = 8.0

_RING_POINTS = 72

# x red, y green, z blue; bright enough on dark and on light images.
AXIS_COLORS: tuple[Color, ...] = (
    (0.95, 0.26, 0.27, 1.0),
    (0.42, 0.80, 0.25, 1.0),
    (0.25, 0.56, 1.00, 1.0),
)

YAW: Color = (0.10, 0.88, 0.85, 1.0)

NEUTRAL: Color = (0.96, 0.96, 0.96, 0.95)

HOVERED: Color = (1.0, 0.83, 0.20, 1.0)

_SHADOW: Color = (0.0, 0.0, 0.0, 0.45)


class Part(StrEnum):
    """Kind of a handle."""

    ARROW = "arrow"  # along an axis
    DEPTH = "depth"  # along an axis that points at the eye
    DISC = "disc"  # parallel to the image
    RING = "ring"  # about an axis
    YAW = "yaw"  # about the table's normal
    VIEW_RING = "view_ring"  # about the line of sight


@dataclass(frozen=True)
class Handle:
    """One handle; `axis` is 0, 1, 2, or -1 for parts without an axis."""

    part: Part
    axis: int = -1


@dataclass(frozen=True, eq=False)
class GizmoFrame:
    """The handles of an object on the screen.

    Attributes:
        camera: pinhole of the view.
        centre: (3,) centre of rotation, eye coordinates, metres.
        axes: (3, 3) unit vectors in its columns, eye coordinates.
        size_px: length of an arrow across the line of sight.
        up: (3,) the table's normal, eye coordinates.
    """

    camera: ScreenCamera
    centre: Array
    axes: Array
    size_px: float
    up: Array

    @property
    def length_m(self) -> float:
        """Length of an arrow in metres, for a constant size on the screen."""
        return self.size_px * self.camera.pixel_m(float(self.centre[2]))

    @cached_property
    def middle(self) -> Array:
        """(2,) screen position of the centre."""
        return self.camera.project(self.centre)

    @property
    def sight(self) -> Array:
        """(3,) unit vector from the eye to the centre."""
        sight: Array = self.centre / np.linalg.norm(self.centre)
        return sight

    def handles(self, gizmo: Gizmo) -> list[Handle]:
        """Return the handles shown, foremost last."""
        if gizmo is Gizmo.MOVE:
            arrows = [
                Handle(Part.DEPTH if self._points_at_eye(i) else Part.ARROW, i) for i in range(3)
            ]
            arrows.sort(key=lambda h: float(self.axes[2, h.axis]), reverse=True)
            return [Handle(Part.YAW), *arrows, Handle(Part.DISC)]
        if gizmo is Gizmo.TURN:
            rings = [Handle(Part.RING, i) for i in range(3)]
            return [Handle(Part.VIEW_RING), Handle(Part.YAW), *rings]
        return []

    def line(self, handle: Handle) -> Array:
        """Return (N, 2) screen positions along a handle; (0, 2) if it is behind the eye."""
        if self.centre[2] <= drags.NEAREST_M:
            return np.zeros((0, 2))
        if handle.part is Part.DEPTH:
            return self.middle + self.depth_direction(handle.axis) * self.size_px * np.array(
                [[ARROW_START], [0.8]]
            )
        if handle.part is Part.ARROW:
            steps = np.array([[ARROW_START], [1.0]]) * self.length_m
            return self.camera.project(self.centre + steps * self.axes[:, handle.axis])
        if handle.part is Part.DISC:
            return self._circle(np.array([0.0, 0.0, 1.0]), DISC)
        return self._circle(*self._ring(handle))

    def in_front(self, handle: Handle) -> NDArray[np.bool_]:
        """Return (N,) whether points of `line` are on the near side of the object."""
        line = self.line(handle)
        if handle.part not in (Part.RING, Part.YAW):
            return np.ones(len(line), bool)
        axis, radius = self._ring(handle)
        out = _circle_directions(axis) * radius * self.length_m
        near: NDArray[np.bool_] = out @ self.sight <= 1e-9 * self.length_m
        return near

    def hit(self, gizmo: Gizmo, xy: ArrayLike) -> Handle | None:
        """Return the handle at a screen position, the foremost of equally near ones, or None."""
        point = np.asarray(xy, dtype=np.float64)
        best, found = REACH_PX, None
        for handle in self.handles(gizmo):
            line = self.line(handle)
            if len(line) == 0:
                continue
            if handle.part is Part.DISC:
                distance = float(np.linalg.norm(point - self.middle)) - DISC * self.size_px
                distance = max(distance, 0.0)
            else:
                closed = handle.part in (Part.RING, Part.YAW, Part.VIEW_RING)
                distance = _distance(line, point, self.in_front(handle), closed=closed)
            if distance <= best:
                best, found = distance, handle
        return found

    def grab(self, handle: Handle, xy: ArrayLike, T_eye_obj: SE3) -> drags.Drag:
        """Start to drag a handle with the pointer at `xy`."""
        at = np.asarray(xy, dtype=np.float64)
        if handle.part is Part.DISC:
            grabbed = self.camera.ray(at) * self.centre[2]
            return drags.PlaneDrag(self.camera, grabbed, T_eye_obj)
        if handle.part is Part.ARROW:
            return drags.AxisDrag(
                self.camera, self.centre, self.axes[:, handle.axis], at, T_eye_obj
            )
        if handle.part is Part.DEPTH:
            gain = DEPTH_GAIN * self.camera.pixel_m(float(self.centre[2]))
            direction = self.depth_direction(handle.axis)
            return drags.DepthDrag(direction * gain, self.axes[:, handle.axis], at, T_eye_obj)
        axis, radius = self._ring(handle)
        return drags.RingDrag(self.camera, self.centre, axis, radius * self.length_m, at, T_eye_obj)

    def depth_direction(self, axis: int) -> Array:
        """Return the screen direction (2,) of the handle of an axis along the line of sight."""
        away = np.sign(self.axes[:, axis] @ self.sight) or 1.0
        return away * np.array([1.0, -1.0]) / np.sqrt(2)

    def _points_at_eye(self, axis: int) -> bool:
        across = np.linalg.norm(np.cross(self.sight, self.axes[:, axis]))
        return bool(across < SHORTEST_ARROW)

    def _ring(self, handle: Handle) -> tuple[Array, float]:
        """Return the axis of a ring and its radius as a fraction of the gizmo's size."""
        if handle.part is Part.VIEW_RING:
            return self.sight, VIEW_RING
        if handle.part is Part.YAW:
            return self.up, YAW_RING
        return self.axes[:, handle.axis], 1.0

    def _circle(self, axis: Array, radius: float) -> Array:
        return self.camera.project(self.centre + _circle_directions(axis) * radius * self.length_m)


def _circle_directions(axis: Array) -> Array:
    u, v = drags.plane_basis(axis)
    angle = 2 * np.pi * np.arange(_RING_POINTS) / _RING_POINTS
    directions: Array = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    return directions


def _distance(line: Array, point: Array, usable: NDArray[np.bool_], *, closed: bool) -> float:
    """Return the distance of a screen position to the segments whose ends are both usable."""
    a = line if closed else line[:-1]
    b = np.roll(line, -1, axis=0) if closed else line[1:]
    good = (usable & np.roll(usable, -1)) if closed else (usable[:-1] & usable[1:])
    a, b = a[good], b[good]
    if len(a) == 0:
        return float("inf")
    along = b - a
    share = np.einsum("ij,ij->i", point - a, along) / np.maximum((along**2).sum(axis=1), 1e-12)
    foot = a + np.clip(share, 0, 1)[:, None] * along
    return float(np.linalg.norm(foot - point, axis=1).min())


def draw_gizmo(
    strokes: Strokes,
    frame: GizmoFrame,
    gizmo: Gizmo,
    *,
    hovered: Handle | None,
    only: Handle | None = None,
    scale: float = 1.0,
) -> None:
    """Add the handles to a drawing.

    Args:
        hovered: handle to highlight.
        only: handle being dragged; the others are not drawn.
        scale: physical pixels per logical one.
    """
    for handle in frame.handles(gizmo):
        if only is not None and handle != only:
            continue
        color = NEUTRAL if handle.axis < 0 else AXIS_COLORS[handle.axis]
        color = YAW if handle.part is Part.YAW else color
        lit = handle in (hovered, only)
        _draw_handle(
            strokes, frame, handle, HOVERED if lit else color, scale * (1.35 if lit else 1.0)
        )


def _draw_handle(
    strokes: Strokes, frame: GizmoFrame, handle: Handle, color: Color, scale: float
) -> None:
    line = frame.line(handle)
    if len(line) == 0 or not np.isfinite(line).all():
        return
    width = 2.6 * scale
    if handle.part is Part.DISC:
        strokes.disc(frame.middle, DISC * frame.size_px, _faded(color, 0.25))
        strokes.line(line, 3.6 * scale, _SHADOW, closed=True)
        strokes.line(line, 1.8 * scale, color, closed=True)
        strokes.disc(frame.middle, 1.8 * scale, color)
    elif handle.part in (Part.ARROW, Part.DEPTH):
        _arrow(strokes, line, color, width, dashed=handle.part is Part.DEPTH)
    elif handle.part is Part.VIEW_RING:
        strokes.line(line, 3.4 * scale, _SHADOW, closed=True)
        strokes.line(line, 1.6 * scale, _faded(color, 0.9), closed=True)
    else:
        near = frame.in_front(handle)
        strokes.line(line, 1.2 * scale, _faded(color, 0.3), closed=True)
        for part in _runs(line, near):
            strokes.line(part, width + 2 * scale, _SHADOW)
            strokes.line(part, width, color)


def _arrow(
    strokes: Strokes, line: NDArray[np.floating], color: Color, width: float, *, dashed: bool
) -> None:
    start, end = line[0], line[-1]
    length = float(np.linalg.norm(end - start))
    if length < 1e-6:
        return
    along = (end - start) / length
    across = np.array([-along[1], along[0]])
    head = min(5.2 * width, 0.6 * length)
    neck = end - along * head * 0.9
    if dashed:
        count = max(2, int(length / (4 * width)))
        cuts = np.linspace(0, 1, 2 * count)
        points = start + (neck - start) * cuts[:, None]
        pieces = points.reshape(-1, 2, 2)
    else:
        pieces = np.array([[start, neck]])
    strokes.segments(pieces, width + 2, _SHADOW)
    tip = np.array([end + along, neck + across * head * 0.42, neck - across * head * 0.42])
    strokes.line(tip, 2.4, _SHADOW, closed=True)
    strokes.segments(pieces, width, color)
    strokes.polygon(tip, color)


def _runs(line: NDArray[np.floating], on: NDArray[np.bool_]) -> list[NDArray[np.floating]]:
    """Return the connected parts of a closed line whose points are `on`."""
    if on.all():
        return [np.concatenate([line, line[:1]])]
    if not on.any():
        return []
    start = int(np.flatnonzero(~on)[0])
    line, on = np.roll(line, -start, axis=0), np.roll(on, -start)
    edges = np.flatnonzero(np.diff(np.r_[False, on, False].astype(np.int8)))
    return [line[a:b] for a, b in edges.reshape(-1, 2) if b - a > 1]


def _faded(color: Color, opacity: float) -> Color:
    return (*color[:3], color[3] * opacity)
