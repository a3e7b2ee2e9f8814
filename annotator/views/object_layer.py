"""Objects of a session in one view: selection of what is drawn, appearance and picking."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from annotator.app.view_options import Mode, Style
from annotator.views import layers, meshes, projection, solids, viewpoint
from annotator.views.strokes import rgba
from std_toolkit.html.plots import object_color

if TYPE_CHECKING:
    from std_toolkit.geometry import SE3
    from std_toolkit.labels.support.penetration import Penetration
    from std_toolkit.scene import Model

Array = NDArray[np.float64]

# Widths of silhouettes, logical pixels.
CONTOUR_PX, WIRE_PX, SELECTED_PX = 2.4, 1.4, 2.6
SELECTED_COLOR = (1.0, 1.0, 1.0)


class ObjectLayer:
    """The objects drawn in one view."""

    def __init__(self, layers: layers.Layers, shapes: meshes.ShapeStore) -> None:
        self._layers, self._shapes = layers, shapes
        self._solids: dict[str, solids.Solid] = {}
        self._penetrations: tuple[Penetration, ...] = ()
        self._red: dict[str, NDArray[np.int64]] = {}

    def show(
        self, view: viewpoint.Viewpoint, *, light: bool, off: bool, pixel_ratio: float
    ) -> None:
        """Draw the current objects.

        Args:
            light: draw light meshes.
            off: hide the objects; they can still be picked.
        """
        state = view.controller.session.state
        ids = [o.id for o in state.objects]
        self.set_penetrations(view.controller.penetrations)
        looks: dict[str, solids.Appearance] = {}
        for name in self._solids.keys() - {o.name for o in state.objects}:
            self._solids.pop(name).close()
        for obj in state.objects:
            solid = self._solid_of(obj.name, state.model(obj.model))
            if solid is None:
                continue
            color = rgba(object_color(ids, obj.id))[:3]
            look = _look(view, obj.name, color, light=light, pixel_ratio=pixel_ratio)
            T_eye_obj = view.T_eye_obj(obj.name) if _is_shown(view, obj.name) else None
            look = replace(
                look, red=self._painted(view, obj.name), size_px=_size_px(view, solid, T_eye_obj)
            )
            solid.show(T_eye_obj, look, seen=not off)
            looks[obj.name] = look
        self._outline(view, looks)

    def set_penetrations(self, found: tuple[Penetration, ...]) -> None:
        """Set the faces painted red: those inside another object or the table."""
        if found is self._penetrations:
            return
        self._penetrations = found
        parts: dict[str, list[NDArray[np.int64]]] = {}
        for pair in found:
            parts.setdefault(pair.first, []).append(pair.first_surface.faces)
            parts.setdefault(pair.second, []).append(pair.second_surface.faces)
        self._red = {name: np.unique(np.concatenate(f)) for name, f in parts.items()}

    def _painted(self, view: viewpoint.Viewpoint, name: str) -> NDArray[np.int64] | None:
        # Invalid during a drag, and in a frame that has its own poses.
        controller = view.controller
        if not controller.options.penetration or controller.dragging == name:
            return None
        if not controller.penetrations_in(view.frame):
            return None
        return self._red.get(name)

    def solid(self, name: str | None) -> solids.Solid | None:
        """Return the object as drawn; None if its mesh is not available yet."""
        return self._solids.get(name) if name is not None else None

    def placed(self) -> dict[str, solids.Solid]:
        """Return the objects drawn at a pose, by name."""
        return {n: s for n, s in self._solids.items() if s.T_eye_obj is not None}

    def extent(self, screen: projection.ScreenCamera) -> Array | None:
        """Return (2, 2) corners of the objects' bounding box on the screen; None without any."""
        seen = [
            screen.project(solid.T_eye_obj @ solid.shape.corners)
            for solid in self.placed().values()
            if solid.T_eye_obj is not None
        ]
        if not seen:
            return None
        corners = np.concatenate(seen)
        if not np.isfinite(corners).all():
            # An object extends behind the eye.
            return np.array([[0.0, 0.0], [screen.width, screen.height]])
        return np.stack([corners.min(axis=0) - 2, corners.max(axis=0) + 2])

    def pick(self, view: viewpoint.Viewpoint, xy: Array) -> tuple[str, float] | None:
        """Return the foremost object at a screen position and the depth of the hit, or None."""
        hits = {name: self._hit(view, name, xy) for name in self.placed()}
        depths = {name: hit[0] for name, hit in hits.items() if hit is not None}
        if not depths:
            return None
        name = min(depths, key=depths.__getitem__)
        return name, depths[name]

    def depth_on(self, view: viewpoint.Viewpoint, name: str, xy: Array) -> float | None:
        """Return an object's depth at a screen position, ignoring occlusion; None if missed."""
        hit = self._hit(view, name, xy)
        return None if hit is None else hit[0]

    def pick_on(self, view: viewpoint.Viewpoint, name: str, xy: Array) -> Array | None:
        """Return the mesh point (3,) of an object at a screen position, ignoring occlusion."""
        hit = self._hit(view, name, xy)
        return None if hit is None else hit[1]

    def _hit(self, view: viewpoint.Viewpoint, name: str, xy: Array) -> tuple[float, Array] | None:
        """Return the depth of the hit on an object and the point (3,) on its mesh, or None."""
        solid = self.placed().get(name)
        if solid is None or solid.T_eye_obj is None:
            return None
        T_obj_eye = solid.T_eye_obj.inverse()
        # The ray direction has z = 1 in eye coordinates, so its multiple is the depth.
        return solid.shape.hit(T_obj_eye.t, T_obj_eye.R @ view.screen.ray(xy))

    def close(self) -> None:
        for solid in self._solids.values():
            solid.close()

    def _solid_of(self, name: str, model: Model) -> solids.Solid | None:
        known, shape = self._solids.get(name), self._shapes.get(model)
        if known is not None and known.shape is not shape:
            # The mesh of the object has changed.
            self._solids.pop(name).close()
            known = None
        if known is None and shape is not None:
            known = self._solids[name] = solids.Solid(self._layers, shape)
        return known

    def _outline(self, view: viewpoint.Viewpoint, looks: dict[str, solids.Appearance]) -> None:
        by_solid = {id(self._solids[name]): look for name, look in looks.items()}
        selected = self.solid(view.controller.selected)
        order = solids.front_to_back([self._solids[name] for name in looks], selected)
        # Objects after the last contour occlude none.
        while order and not by_solid[id(order[-1])].contour:
            order.pop()
        screen = view.screen
        for slot, solid in enumerate(order):
            look = by_solid[id(solid)]
            color = SELECTED_COLOR if solid is selected else look.color
            solid.outline(screen, look, slot, len(order), (*color, 1.0))


def _is_shown(view: viewpoint.Viewpoint, name: str) -> bool:
    controller = view.controller
    if controller.options.hidden:
        return False
    return not controller.options.only_selected or name == controller.selected


def _size_px(view: viewpoint.Viewpoint, solid: solids.Solid, T_eye_obj: SE3 | None) -> float:
    """Return the diameter of an object on the screen."""
    depth = 1.0 if T_eye_obj is None else float((T_eye_obj @ solid.shape.centre)[2])
    return 2 * solid.shape.radius / view.screen.pixel_m(max(depth, layers.NEAR_M))


def _look(
    view: viewpoint.Viewpoint,
    name: str,
    color: tuple[float, float, float],
    *,
    light: bool,
    pixel_ratio: float,
) -> solids.Appearance:
    controller, options = view.controller, view.controller.options
    selected = name == controller.selected
    if options.style is Style.CONTOUR or options.contour_always:
        rim = CONTOUR_PX
    else:
        # During motion only the surface lines are drawn: outlines would double the time.
        rim = WIRE_PX if options.style is Style.WIREFRAME and not light else 0.0
    if selected:
        # In the cloud the outline is visible through objects in front.
        rim = SELECTED_PX if view.mode is Mode.IMAGE or rim else WIRE_PX
    return solids.Appearance(
        color=color,
        style=options.style,
        contour=rim * pixel_ratio,
        light=light,
        # Over an image the veil makes meshes translucent.
        opacity=options.opacity if view.mode is Mode.CLOUD else 1.0,
    )
