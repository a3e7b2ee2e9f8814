"""How the handles are drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from annotator.desk.view_options import Gizmo
from annotator.views.gizmo import ARROW_START, DISC, GizmoFrame, Handle, Part
from annotator.views.strokes import Color, Strokes

# x red, y green, z blue, as everywhere; bright enough on dark and on light images.
AXIS_COLORS: tuple[Color, ...] = (
    (0.95, 0.26, 0.27, 1.0),
    (0.42, 0.80, 0.25, 1.0),
    (0.25, 0.56, 1.00, 1.0),
)
NEUTRAL: Color = (0.96, 0.96, 0.96, 0.95)
HOVERED: Color = (1.0, 0.83, 0.20, 1.0)
_SHADOW: Color = (0.0, 0.0, 0.0, 0.45)


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
        hovered: highlighted.
        only: the one being dragged; the others are left out.
        scale: physical pixels per logical one.
    """
    for handle in frame.handles(gizmo):
        if only is not None and handle != only:
            continue
        color = NEUTRAL if handle.axis < 0 else AXIS_COLORS[handle.axis]
        lit = handle in (hovered, only)
        _draw(strokes, frame, handle, HOVERED if lit else color, scale * (1.35 if lit else 1.0))


def _draw(strokes: Strokes, frame: GizmoFrame, handle: Handle, color: Color, scale: float) -> None:
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
    """The parts of a closed line whose points are `on`, each in one piece."""
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


__all__ = ["ARROW_START", "AXIS_COLORS", "HOVERED", "draw_gizmo"]
