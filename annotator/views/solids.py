"""Render props of objects: textured, shaded or wireframe meshes and silhouettes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer, vtkTexture

from annotator.app.view_options import Style
from annotator.views import meshes, projection, triangles
from annotator.views.layers import Layers, fill, place
from annotator.views.strokes import Color, Strokes
from annotator.views.triangles import ColoredMesh
from std_toolkit.geometry import SE3

# Replaces the depth of vertices by a constant, so that props drawn first hide later ones.
_FLATTEN = "//VTK::PositionVC::Impl\n  gl_Position.z = slot * gl_Position.w;\n"
# Moves lines on a surface about a millimetre towards the eye.
_NEARER = "//VTK::PositionVC::Impl\n  gl_Position.z -= 5e-5 * gl_Position.w;\n"
# Writes depth without visible colour, for occluders. A fragment with zero opacity would be
# discarded together with its depth.
_INVISIBLE = "//VTK::Light::Impl\n  gl_FragData[0] = vec4(0.0, 0.0, 0.0, 1e-5);\n"
PENETRATION = (0.93, 0.08, 0.10)
_NEAREST_SLOT, _SLOTS = -0.95, 1.9


@dataclass(frozen=True, kw_only=True)
class Appearance:
    """Appearance of an object.

    Attributes:
        color: red, green, blue, 0 to 1.
        style: textured (solid for a mesh without colours), solid, wireframe or contour.
        contour: width of its silhouette in pixels; 0 for none.
        light: draw the light mesh instead of the full one.
        opacity: opacity of its surface; below 1 only if nothing is drawn after it.
        red: (N,) indices of the penetrating faces of the full mesh, or None.
        size_px: size of the object on the screen, which determines the resolution of its texture.
    """

    color: tuple[float, float, float]
    style: Style
    contour: float
    light: bool
    opacity: float = 1.0
    red: NDArray[np.int64] | None = None
    size_px: float = 500.0


class Solid:
    """One object in one view."""

    def __init__(self, layers: Layers, shape: meshes.Shape) -> None:
        self.shape = shape
        self.T_eye_obj: SE3 | None = None
        self.seen = False
        self._layers = layers
        self._bodies: dict[vtkPolyData, vtkActor] = {}
        self._colored: dict[ColoredMesh, _ColoredBody] = {}
        self._hiders: dict[triangles.Surface, vtkActor] = {}
        self._masks: dict[triangles.Surface, vtkActor] = {}
        self._rim, self._rim_data = _rim_actor()
        self._rim_drawn: object = None
        layers.outlines.AddActor(self._rim)
        self._patch = _Patch(layers, shape)

    def show(self, T_eye_obj: SE3 | None, look: Appearance, *, seen: bool = True) -> None:
        """Draw the object at a pose, or remove it (None); if not `seen` it can still be picked."""
        self.T_eye_obj = T_eye_obj
        self.seen = seen and T_eye_obj is not None
        for actor in (*self._surfaces(), *self._hiders.values(), *self._masks.values()):
            actor.VisibilityOff()
        self._rim.VisibilityOff()
        self._patch.show(look.red if self.seen else None, T_eye_obj)
        if T_eye_obj is None or not self.seen or look.style is Style.CONTOUR:
            return
        wire = look.style is Style.WIREFRAME
        surface = self._surface(look.light)
        if wire or look.opacity < 1:
            # Hides the far side, so that lines and translucent faces are drawn once.
            hider = self._hider(surface)
            hider.VisibilityOn()
            place(hider, T_eye_obj)
        if look.style is Style.TEXTURED and surface.colored is not None:
            body = self._colored_body(surface.colored, look.size_px)
            _paint_colored(body, look)
        else:
            lines = self.shape.light_wire if look.light else self.shape.wire
            body = self._body(lines if wire else surface.polydata)
            _paint(body, look)
        body.VisibilityOn()
        place(body, T_eye_obj)

    def outline(
        self,
        camera: projection.ScreenCamera,
        look: Appearance,
        slot: int,
        slots: int,
        color: Color,
    ) -> None:
        """Draw the silhouette; lower slots occlude higher ones."""
        if self.T_eye_obj is None:
            return
        step = _SLOTS / (2 * max(slots, 1))
        depth = _NEAREST_SLOT + 2 * slot * step
        mask = self._mask(self._surface(look.light))
        mask.VisibilityOn()
        place(mask, self.T_eye_obj)
        _set_slot(mask, depth)
        if look.contour <= 0:
            return
        key = (camera, self.T_eye_obj, look.contour, look.light, color)
        if key != self._rim_drawn:
            self._rim_drawn = key
            surface = self._surface(look.light)
            edges = surface.silhouette(self.T_eye_obj.inverse().t)
            seen = camera.project(self.T_eye_obj @ edges.reshape(-1, 3)).reshape(-1, 2, 2)
            strokes = Strokes()
            # The mask hides the inner half of the line, hence the double width.
            strokes.segments(seen, 2 * look.contour, color)
            points, colors, faces = strokes.arrays()
            fill(self._rim_data, camera.ray(points), faces, colors)
        self._rim.VisibilityOn()
        _set_slot(self._rim, depth + step)

    def close(self) -> None:
        for actor in (*self._surfaces(), *self._hiders.values()):
            self._layers.solids.RemoveActor(actor)
        for actor in (*self._masks.values(), self._rim):
            self._layers.outlines.RemoveActor(actor)
        self._patch.show(None, None)

    def _surfaces(self) -> Iterator[vtkActor]:
        yield from self._bodies.values()
        yield from (body.actor for body in self._colored.values())

    def _surface(self, light: bool) -> triangles.Surface:
        return self.shape.light if light else self.shape.full

    def _body(self, polydata: vtkPolyData) -> vtkActor:
        if polydata not in self._bodies:
            self._bodies[polydata] = _mesh_actor(polydata, self._layers.solids)
            if not polydata.GetNumberOfPolys():
                self._bodies[polydata].GetShaderProperty().AddVertexShaderReplacement(
                    "//VTK::PositionVC::Impl", True, _NEARER, False
                )
        return self._bodies[polydata]

    def _colored_body(self, colored: ColoredMesh, size_px: float) -> vtkActor:
        if colored not in self._colored:
            self._colored[colored] = _ColoredBody(colored, self._layers.solids)
        body = self._colored[colored]
        body.fit(size_px)
        return body.actor

    def _hider(self, surface: triangles.Surface) -> vtkActor:
        if surface not in self._hiders:
            actor = _mesh_actor(surface.polydata, self._layers.solids)
            actor.GetShaderProperty().AddFragmentShaderReplacement(
                "//VTK::Light::Impl", True, _INVISIBLE, False
            )
            self._hiders[surface] = actor
        return self._hiders[surface]

    def _mask(self, surface: triangles.Surface) -> vtkActor:
        if surface not in self._masks:
            # Each mask is drawn before its rim, which it partly occludes.
            self._layers.outlines.RemoveActor(self._rim)
            actor = _mesh_actor(surface.polydata, self._layers.outlines)
            self._layers.outlines.AddActor(self._rim)
            actor.GetProperty().LightingOff()
            shader = actor.GetShaderProperty()
            shader.AddVertexShaderReplacement("//VTK::PositionVC::Impl", True, _FLATTEN, False)
            shader.AddFragmentShaderReplacement("//VTK::Light::Impl", True, _INVISIBLE, False)
            self._masks[surface] = actor
        return self._masks[surface]


class _ColoredBody:
    """The prop of a mesh with its own colours."""

    def __init__(self, colored: ColoredMesh, renderer: vtkRenderer) -> None:
        self.actor = _mesh_actor(colored.polydata, renderer)
        self._image = colored.texture
        self._level: int | None = None
        if self._image is None:
            mapper = self.actor.GetMapper()
            mapper.ScalarVisibilityOn()
            mapper.SetColorModeToDirectScalars()
            if colored.by_face:
                mapper.SetScalarModeToUseCellData()
            else:
                mapper.SetScalarModeToUsePointData()
            return
        self._texture = vtkTexture()
        self._texture.SetColorModeToDirectScalars()
        self._texture.InterpolateOn()
        self._texture.SetMipmap(self._image.mipmaps)
        self._texture.SetRepeat(self._image.mipmaps)
        self._texture.SetEdgeClamp(not self._image.mipmaps)
        self.actor.SetTexture(self._texture)

    def fit(self, size_px: float) -> None:
        """Choose the resolution of the texture for a size on the screen."""
        if self._image is None:
            return
        level = self._image.level(size_px, self._level)
        if level != self._level:
            self._level = level
            self._texture.SetInputData(self._image.data(level))


class _Patch:
    """Penetrating faces, drawn red and visible through occluders."""

    def __init__(self, layers: Layers, shape: meshes.Shape) -> None:
        self._layers, self._shape = layers, shape
        self._faces: NDArray[np.int64] | None = None
        self._actor: vtkActor | None = None

    def show(self, faces: NDArray[np.int64] | None, T_eye_obj: SE3 | None) -> None:
        if faces is not self._faces:
            self._faces = faces
            if self._actor is not None:
                self._layers.marks.RemoveActor(self._actor)
            self._actor = None
            if faces is not None and len(faces) > 0 and faces.max() < self._shape.full.faces:
                self._actor = self._make(faces)
        if self._actor is not None and T_eye_obj is not None:
            place(self._actor, T_eye_obj)

    def _make(self, faces: NDArray[np.int64]) -> vtkActor:
        vertices, corners = self._shape.full.corners
        used, index = np.unique(corners[faces], return_inverse=True)
        patch = vtkPolyData()
        fill(patch, vertices[used], index.reshape(-1, 3))
        actor = _mesh_actor(patch, self._layers.marks)
        paint = actor.GetProperty()
        paint.SetColor(*PENETRATION)
        paint.SetOpacity(0.8)
        paint.LightingOff()
        actor.ForceOpaqueOff()
        return actor


def front_to_back(solids: Sequence[Solid], first: Solid | None) -> list[Solid]:
    """Return the visible solids: `first`, then the others sorted by the depth of their centres."""
    placed = [s for s in solids if s.seen]

    def depth(solid: Solid) -> float:
        assert solid.T_eye_obj is not None
        return float((solid.T_eye_obj @ solid.shape.centre)[2])

    return sorted(placed, key=lambda s: (s is not first, depth(s)))


def _paint(actor: vtkActor, look: Appearance) -> None:
    paint = actor.GetProperty()
    paint.SetColor(*look.color)
    if look.style is Style.WIREFRAME:
        paint.LightingOff()
        # Wider lines are several times slower in software rendering.
        paint.SetLineWidth(1.0 if look.light else 1.6)
        return
    paint.LightingOn()
    paint.SetOpacity(look.opacity)
    actor.SetForceOpaque(look.opacity >= 1)
    paint.SetAmbient(0.22)
    paint.SetDiffuse(0.78)
    paint.SetSpecular(0.12)
    paint.SetSpecularPower(20)


def _paint_colored(actor: vtkActor, look: Appearance) -> None:
    paint = actor.GetProperty()
    paint.SetColor(1.0, 1.0, 1.0)
    paint.SetOpacity(look.opacity)
    actor.SetForceOpaque(look.opacity >= 1)
    # Enough shading to see the shape; a texture stays legible on faces seen at a grazing angle.
    paint.SetAmbient(0.55)
    paint.SetDiffuse(0.45)
    paint.SetSpecular(0.0)


def _mesh_actor(polydata: vtkPolyData, renderer: vtkRenderer) -> vtkActor:
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(polydata)
    mapper.ScalarVisibilityOff()
    actor = vtkActor()
    actor.SetMapper(mapper)
    actor.ForceOpaqueOn()
    renderer.AddActor(actor)
    return actor


def _rim_actor() -> tuple[vtkActor, vtkPolyData]:
    polydata = vtkPolyData()
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(polydata)
    actor = vtkActor()
    actor.SetMapper(mapper)
    actor.GetProperty().LightingOff()
    # Opaque pass, to keep the order with the masks despite its soft edges.
    actor.ForceOpaqueOn()
    actor.GetShaderProperty().AddVertexShaderReplacement(
        "//VTK::PositionVC::Impl", True, _FLATTEN, False
    )
    actor.VisibilityOff()
    return actor, polydata


def _set_slot(actor: vtkActor, depth: float) -> None:
    actor.GetShaderProperty().GetVertexCustomUniforms().SetUniformf(
        "slot", float(np.float32(depth))
    )
