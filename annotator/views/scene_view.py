"""Drawing area of one frame: its image or point cloud with the objects over it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.view_options import SURFACE_STYLES, Mode
from annotator.views import (
    cloud_layer,
    layers,
    meshes,
    object_layer,
    overlay,
    picture,
    solids,
)
from annotator.views.clouds import Cloud, CloudReader
from annotator.views.strokes import Strokes
from std_toolkit.errors import ToolkitError

Array = NDArray[np.float64]

# Default depth of a table-top scene.
USUAL_DEPTH_M = 0.7


class SceneView(overlay.OverlaidView):
    """Draws one of the controller's views into a plotter.

    Args:
        plotter: `pyvista.Plotter(off_screen=True)` or `pyvistaqt.QtInteractor`.
        controller: the displayed state.
        slot: index of the view in the controller; 0 is the main one.
        shapes, clouds: shared with other views.
        repaint: requests a repaint of the plotter from the front end.
        pixel_ratio: physical pixels per logical one.

    Attributes:
        moving: whether light meshes and few points are drawn.
        blinked_off: whether meshes are hidden by blinking.
        cloud: the displayed points; None in image mode.
        captions: the text.
    """

    def __init__(
        self,
        plotter: Any,
        controller: Controller,
        *,
        slot: int,
        shapes: meshes.ShapeStore | None = None,
        clouds: CloudReader | None = None,
        repaint: Callable[[], None] | None = None,
        pixel_ratio: float = 1.0,
    ) -> None:
        self.plotter = plotter
        self.layers = layers.Layers(plotter)
        super().__init__(controller, slot=slot, size=self.layers.size, pixel_ratio=pixel_ratio)
        self.moving = False
        self.blinked_off = False
        self.cloud: Cloud | None = None
        self._clouds = clouds or CloudReader(controller)
        self._repaint = repaint or repainter(plotter)
        self._picture = picture.Picture(self.layers)
        self._points, self._table = (
            cloud_layer.CloudLayer(self.layers),
            cloud_layer.TableLayer(self.layers),
        )
        self.objects = object_layer.ObjectLayer(
            self.layers, shapes or meshes.ShapeStore(controller.session.mesh)
        )
        self._strokes = layers.Drawing(self.layers.glass)
        self.captions = layers.Captions(self.layers)
        self._preparing = False
        self._observer = self.layers.window.AddObserver("StartEvent", self._before_render)

    # --- what is seen ---------------------------------------------------------------------------

    def solid(self, name: str | None) -> solids.Solid | None:
        """An object as drawn here; None if its mesh is not there yet."""
        return self.objects.solid(name)

    def point_under(self, xy: Array) -> Array:
        """Return the point (3,) at a screen position, eye coordinates; a guess without a hit."""
        picked = self.objects.pick(self, xy)
        depth = picked[1] if picked is not None else None
        if depth is None and self.mode is Mode.CLOUD:
            depth = self._points.depth_at(self.screen, xy, reach=12 * self.pixel_ratio)
        point: Array = self.screen.ray(xy) * (depth or self._middle_depth())
        return point

    def pivot(self, xy: Array) -> Array:
        """Return the centre (3,) of orbiting: the selected object, else the point under `xy`."""
        solid = self.solid(self.controller.selected)
        if solid is not None and solid.T_eye_obj is not None:
            return solid.T_eye_obj @ solid.shape.centre
        return self.point_under(xy)

    def _middle_depth(self) -> float:
        depths = [
            float((s.T_eye_obj @ s.shape.centre)[2])
            for s in self.objects.placed().values()
            if s.T_eye_obj is not None
        ]
        depths = [d for d in depths if d > 0]
        return float(np.median(depths)) if depths else USUAL_DEPTH_M

    # --- drawing --------------------------------------------------------------------------------

    def refresh(self, event: Event | None = None) -> None:
        """Update what the event may have changed; None for everything. Does not render."""
        if event is not None and event.kind == "look":
            self._look(event.text)
        if self.mode is Mode.CLOUD:
            self._clouds.prepare(self.controller.options.cloud)
        self._prepare()

    def draw(self) -> None:
        """Update from the controller's state and request a repaint."""
        self.refresh()
        self._repaint()

    def screenshot(self) -> NDArray[np.uint8]:
        """Render now; (H, W, 3) RGB uint8."""
        self.refresh()
        return self.layers.read()

    def close(self) -> None:
        """Remove everything from the plotter, which stays open."""
        self.layers.window.RemoveObserver(self._observer)
        self.objects.close()
        self.captions.close()
        self.layers.close()

    def _before_render(self, *_: object) -> None:
        # The front end may render by itself, for example after a resize.
        if self.layers.size != self.size:
            self._prepare()

    def _prepare(self) -> None:
        if self._preparing:
            return
        self._preparing = True
        try:
            self.resize(self.layers.size)
            self.settle_reference()
            self.layers.look(self.screen)
            self.objects.show(
                self, light=self.moving, off=self.blinked_off, pixel_ratio=self.pixel_ratio
            )
            self._show_image()
            self._show_cloud()
            self._show_glass()
        finally:
            self._preparing = False

    def _show_image(self) -> None:
        image = None
        self.problem = ""
        if self.mode is Mode.IMAGE:
            try:
                image = self.controller.images.image(self.frame).rgb
            except ToolkitError as error:
                self.problem = str(error)
        self._picture.show(image)
        options = self.controller.options
        part = self.objects.extent(self.screen) if options.style in SURFACE_STYLES else None
        self._picture.place(
            self.window, veil=0.0 if part is None else 1 - options.opacity, part=part
        )

    def _show_cloud(self) -> None:
        if self.mode is not Mode.CLOUD:
            self.cloud = None
            self._points.show(None, None, light=False, pixels_per_metre=1.0)
            self._table.show(None, None)
            return
        cloud = self.cloud = self._clouds.get(self.frame, self.controller.options.cloud)
        self.problem = cloud.note
        T_eye_points = self.T_eye_world if cloud.in_world else self.T_eye_cam
        self._points.show(
            cloud,
            T_eye_points,
            light=self.moving,
            pixels_per_metre=1 / self.screen.pixel_m(self._middle_depth()),
        )
        table = self.controller.table
        if table is None or not self.controller.options.table:
            self._table.show(None, None)
        else:
            plane = (table.plane.normal, table.centre, table.radius_m)
            self._table.show(plane, self.T_eye_of(table.plane.frame))

    def _show_glass(self) -> None:
        strokes = Strokes()
        self.captions.begin()
        overlay.draw_overlay(strokes, self.captions, self)
        self.captions.end()
        self._strokes.show(strokes)

    def _look(self, what: str) -> None:
        if what == "fit":
            self.eye.fit()
            return
        solid, pose = self.solid(self.controller.selected), None
        if solid is not None and self.controller.selected is not None:
            pose = self.controller.pose(self.controller.selected, self.frame)
        if solid is None or pose is None:
            return
        centre = pose @ solid.shape.centre
        if centre[2] > 0:
            reach = 1.5 * solid.shape.radius * self.camera.fx / float(centre[2])
            self.eye.T_eye_ref = None
            self.eye.look_at(self.camera.project(centre), reach, self.size)


def repainter(plotter: Any) -> Callable[[], None]:
    """Return the repaint function of a plotter: Qt repaints once per event loop pass."""
    # A QOpenGLWidget renders when it is painted; an explicit call would render twice.
    schedule: Callable[[], None] | None = getattr(plotter, "Render", None)
    return schedule if schedule is not None else plotter.render_window.Render


def recorded_pixel_under(view: SceneView, xy: NDArray[np.float64]) -> tuple[float, float]:
    """Return the pixel of the recorded image, with lens distortion, at a screen position.

    Args:
        xy: (2,) physical pixels from the top left corner of the drawing area.
    """
    if view.mode is Mode.IMAGE:
        return view.recorded_pixel(xy)
    seen = view.recorded_camera.project(view.T_eye_cam.inverse() @ view.point_under(xy))
    if not np.isfinite(seen).all():
        # Behind the camera of the frame: use the image centre.
        camera = view.recorded_camera
        return camera.width / 2, camera.height / 2
    return float(seen[0]), float(seen[1])
