"""View of a single mesh that can be rotated and clicked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotator.app.placing import front_rotation
from annotator.app.view_options import Style
from annotator.views import interaction, layers, meshes, projection, scene_view, solids
from annotator.views.strokes import Color, Strokes, rgba
from std_toolkit.geometry import SE3, so3_exp

Array = NDArray[np.float64]
OnClick = Callable[[tuple[float, float, float]], None]

# Distance of the eye in mesh radii at which the mesh fills the view.
DISTANCE = 6.0
_FILL = 0.88
_DRAG_PX = 3.0
_POINT: Color = (0.3, 0.95, 1.0, 1.0)
_PENDING: Color = (1.0, 0.83, 0.2, 1.0)
_SHADOW: Color = (0.0, 0.0, 0.0, 0.6)


class ModelView:
    """Draws a mesh into a plotter; the left button rotates it, the wheel zooms.

    Args:
        plotter: `pyvista.Plotter(off_screen=True)` or `pyvistaqt.QtInteractor`.
        on_click: called with the clicked point (x, y, z) of the mesh, mesh frame, metres.
        repaint: requests a repaint of the plotter from the front end.
        pixel_ratio: physical pixels per logical one.
    """

    def __init__(
        self,
        plotter: Any,
        *,
        on_click: OnClick | None = None,
        repaint: Callable[[], None] | None = None,
        pixel_ratio: float = 1.0,
    ) -> None:
        self.layers = layers.Layers(plotter)
        self.pixel_ratio = pixel_ratio
        self.zoom = 1.0
        self.R_eye_obj = np.eye(3)
        self._shift = np.zeros(2)
        self._up = 2
        self._solid: solids.Solid | None = None
        self._look = solids.Appearance(
            color=(0.7, 0.75, 0.8), style=Style.SOLID, contour=0.0, light=False
        )
        self._points: list[Array] = []
        self._pending: Array | None = None
        self._on_click = on_click
        self._repaint = repaint or scene_view.repainter(plotter)
        self._strokes = layers.Drawing(self.layers.glass)
        self._captions = layers.Captions(self.layers)
        self._pressed: tuple[str, Array, Array] | None = None
        self._dragging = False
        self._events = interaction.Events(
            plotter,
            {
                "LeftButtonPressEvent": lambda *_: self._press("turn"),
                "LeftButtonReleaseEvent": self._release,
                "MiddleButtonPressEvent": lambda *_: self._press("shift"),
                "MiddleButtonReleaseEvent": self._release,
                "RightButtonPressEvent": lambda *_: self._press("shift"),
                "RightButtonReleaseEvent": self._release,
                "MouseMoveEvent": self._move,
                "MouseWheelForwardEvent": lambda *_: self._wheel(1.18),
                "MouseWheelBackwardEvent": lambda *_: self._wheel(1 / 1.18),
            },
        )
        self._render_observer = self.layers.window.AddObserver("StartEvent", self._prepare)

    # --- what is shown --------------------------------------------------------------------------

    def show(
        self,
        shape: meshes.Shape | None,
        color: str | Sequence[float] = "#c0c0c0",
        *,
        up: int = 2,
        style: Style = Style.TEXTURED,
    ) -> None:
        """Show a mesh, or nothing; a new mesh is seen from its front.

        Args:
            color: of a mesh without texture or vertex colours, and of others in style solid.
            up: the coordinate axis of the mesh (0, 1, 2) that is up.
            style: textured or solid.
        """
        self._up = up
        if shape is not (self._solid.shape if self._solid else None):
            if self._solid is not None:
                self._solid.close()
            self._solid = None if shape is None else solids.Solid(self.layers, shape)
            self.fit()
        self._look = solids.Appearance(color=rgba(color)[:3], style=style, contour=0.0, light=False)

    def set_points(
        self, points: Sequence[Sequence[float]], pending: Sequence[float] | None = None
    ) -> None:
        """Mark points of the mesh, numbered from 1, and the pending point."""
        self._points = [np.asarray(p, dtype=np.float64) for p in points]
        self._pending = None if pending is None else np.asarray(pending, dtype=np.float64)

    def fit(self) -> None:
        """Reset the eye: the whole mesh from above its front."""
        self.zoom, self._shift = 1.0, np.zeros(2)
        if self._solid is not None:
            self.R_eye_obj = front_rotation(self._up)

    def draw(self) -> None:
        """Request a repaint."""
        self._prepare()
        self._repaint()

    def screenshot(self) -> NDArray[np.uint8]:
        """Render now; (H, W, 3) RGB uint8."""
        self._prepare()
        return self.layers.read()

    def close(self) -> None:
        """Remove everything from the plotter, which stays open."""
        self._events.close()
        self.layers.window.RemoveObserver(self._render_observer)
        self._captions.close()
        self.layers.close()

    # --- geometry -------------------------------------------------------------------------------

    @property
    def screen(self) -> projection.ScreenCamera:
        width, height = self.layers.size
        f = self.zoom * _FILL * min(width, height) / 2 * DISTANCE
        x, y = self._shift
        return projection.ScreenCamera(width, height, f, f, width / 2 + x, height / 2 + y)

    @property
    def T_eye_obj(self) -> SE3:
        """Pose of the mesh, whose centre is on the optical axis."""
        shape = self._solid.shape if self._solid else None
        centre = np.zeros(3) if shape is None else shape.centre
        distance = DISTANCE * (1.0 if shape is None else max(shape.radius, 1e-6))
        return SE3(self.R_eye_obj, np.array([0.0, 0.0, distance]) - self.R_eye_obj @ centre)

    def point_at(self, xy: Array) -> Array | None:
        """Return the point (3,) of the mesh at a screen position; None outside the mesh."""
        if self._solid is None:
            return None
        T_obj_eye = self.T_eye_obj.inverse()
        hit = self._solid.shape.hit(T_obj_eye.t, T_obj_eye.R @ self.screen.ray(xy))
        return None if hit is None else hit[1]

    # --- drawing --------------------------------------------------------------------------------

    def _prepare(self, *_: object) -> None:
        self.layers.look(self.screen)
        if self._solid is not None:
            size_px = 2 / self.screen.pixel_m(DISTANCE)
            self._solid.show(self.T_eye_obj, replace(self._look, size_px=size_px))
        strokes = Strokes()
        self._captions.begin()
        marks = [(p, _POINT, str(i)) for i, p in enumerate(self._points, start=1)]
        if self._pending is not None:
            marks.append((self._pending, _PENDING, ""))
        for point, color, text in marks:
            self._mark(strokes, point, color, text)
        self._captions.end()
        self._strokes.show(strokes)

    def _mark(self, strokes: Strokes, point: Array, color: Color, text: str) -> None:
        scale = self.pixel_ratio
        seen = self.T_eye_obj @ point
        x, y = self.screen.project(seen)
        # Points on the far side are pale.
        hit = self.point_at(np.array([x, y]))
        near = hit is None or float((self.T_eye_obj @ hit)[2]) > float(seen[2]) - 0.002
        strength = 1.0 if near else 0.35
        strokes.disc((x, y), 5.0 * scale, (*_SHADOW[:3], _SHADOW[3] * strength))
        strokes.disc((x, y), 3.4 * scale, (*color[:3], strength))
        if text and near:
            self._captions.say(
                f"point {text}", text, (x + 7 * scale, y - 7 * scale), size=11 * scale,
                valign="bottom",
            )  # fmt: skip

    # --- mouse ----------------------------------------------------------------------------------

    def _at(self) -> Array:
        x, y = self._events.interactor.GetEventPosition()
        return np.array([x + 0.5, self.layers.size[1] - y - 0.5])

    def _press(self, what: str) -> None:
        at = self._at()
        self._pressed, self._dragging = (what, at, at), False

    def _move(self, *_: object) -> None:
        if self._pressed is None:
            return
        what, start, last = self._pressed
        at = self._at()
        if not self._dragging and np.abs(at - start).max() < _DRAG_PX * self.pixel_ratio:
            return
        self._dragging = True
        self._pressed = (what, start, at)
        dx, dy = at - last
        if what == "turn":
            per_pixel = np.pi / max(min(self.layers.size), 1)
            self.R_eye_obj = so3_exp(np.array([dy, -dx, 0.0]) * per_pixel) @ self.R_eye_obj
        else:
            self._shift = self._shift + np.array([dx, dy])
        self.draw()

    def _release(self, *_: object) -> None:
        pressed, self._pressed = self._pressed, None
        if pressed is None or self._dragging or pressed[0] != "turn" or self._on_click is None:
            return
        point = self.point_at(self._at())
        if point is not None:
            self._on_click((float(point[0]), float(point[1]), float(point[2])))

    def _wheel(self, factor: float) -> None:
        before = self.zoom
        self.zoom = float(np.clip(self.zoom * factor, 0.3, 60.0))
        middle = np.array(self.layers.size) / 2
        # The point under the pointer stays under it.
        at = self._at() - middle
        self._shift = at + (self._shift - at) * (self.zoom / before)
        self.draw()
