"""Rendering layers of one drawing area, from back to front.

0 backdrop: background colour and the image.  1 solids: meshes and clouds in perspective.
2 veil: the image again, translucent, which makes the meshes evenly translucent without sorting
triangles.  3 marks: paint on surfaces that is visible through others.  4 outlines: silhouettes.
5 glass: lines and text on top.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkCommonMath import vtkMatrix4x4
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkActor2D,
    vtkCamera,
    vtkLight,
    vtkPolyDataMapper,
    vtkProp,
    vtkRenderer,
    vtkTextActor,
    vtkTextProperty,
    vtkWindowToImageFilter,
)
from vtkmodules.vtkRenderingOpenGL2 import vtkGenericOpenGLRenderWindow

from annotator.views.projection import ScreenCamera
from annotator.views.strokes import Strokes
from std_toolkit.geometry import SE3

BACKGROUND = (0.118, 0.118, 0.122)

# Depth range in metres: 24 bits give a resolution of 10 micrometres at arm's length.
NEAR_M, FAR_M = 0.01, 60.0

PAPER = (0.06, 0.07, 0.085)

INK = (0.93, 0.94, 0.95)

FAINT = (0.70, 0.73, 0.77)


class Layers:
    """The renderers of a plotter's window.

    Args:
        plotter: a `pyvista.Plotter` or a `pyvistaqt.QtInteractor`; its own renderer is the
            backdrop.
    """

    def __init__(self, plotter: Any) -> None:
        self.window = plotter.render_window
        if not isinstance(self.window, vtkGenericOpenGLRenderWindow):
            # The widget sets its samples according to the renderer. Off-screen rendering mostly
            # runs on the CPU, where multisampling takes several times as long.
            self.window.SetMultiSamples(0)
        self.backdrop: vtkRenderer = plotter.renderer
        self.solids, self.veil, self.marks = vtkRenderer(), vtkRenderer(), vtkRenderer()
        self.outlines, self.glass = vtkRenderer(), vtkRenderer()
        self.window.SetNumberOfLayers(6)
        self._flat, self._deep = vtkCamera(), vtkCamera()
        for layer, renderer in enumerate(self._own, start=1):
            renderer.SetLayer(layer)
            renderer.InteractiveOff()
            self.window.AddRenderer(renderer)
        for renderer in (self.backdrop, *self._own):
            renderer.SetUseOIT(False)
            renderer.SetAutomaticLightCreation(False)
            renderer.RemoveAllLights()
            deep = renderer in (self.solids, self.marks, self.outlines)
            renderer.SetActiveCamera(self._deep if deep else self._flat)
        self.backdrop.SetBackground(*BACKGROUND)
        self.backdrop.GradientBackgroundOff()
        self._deep.SetPosition(0, 0, 0)
        self._deep.SetFocalPoint(0, 0, 1)
        self._deep.SetViewUp(0, -1, 0)
        # A single light at the eye: each further one adds the same time in software rendering.
        light = vtkLight()
        light.SetLightTypeToHeadlight()
        self.solids.AddLight(light)

    @property
    def _own(self) -> tuple[vtkRenderer, ...]:
        return self.solids, self.veil, self.marks, self.outlines, self.glass

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in physical pixels."""
        width, height = self.window.GetSize()
        return max(width, 1), max(height, 1)

    def look(self, camera: ScreenCamera) -> None:
        """Set the pinhole of the perspective layers; the others use screen positions."""
        _set_projection(self._deep, camera.clip_matrix(NEAR_M, FAR_M))
        P = np.diag([2 / camera.width, -2 / camera.height, -1.0, 1.0])
        P[0, 3], P[1, 3] = -1, 1
        _set_projection(self._flat, P)

    def read(self) -> NDArray[np.uint8]:
        """Render and return (H, W, 3) RGB."""
        self.window.MakeCurrent()
        self.window.Render()
        grab = vtkWindowToImageFilter()
        grab.SetInput(self.window)
        grab.ShouldRerenderOff()
        grab.ReadFrontBufferOff()
        grab.Update()
        data = grab.GetOutput()
        width, height, _ = data.GetDimensions()
        flat = vtk_to_numpy(data.GetPointData().GetScalars())
        return np.ascontiguousarray(flat.reshape(height, width, -1)[::-1, :, :3])

    def close(self) -> None:
        self.backdrop.RemoveAllViewProps()
        for renderer in self._own:
            renderer.RemoveAllViewProps()
            self.window.RemoveRenderer(renderer)


def _set_projection(camera: vtkCamera, P: NDArray[np.floating]) -> None:
    matrix = vtkMatrix4x4()
    matrix.DeepCopy(P.ravel().tolist())
    camera.SetExplicitProjectionTransformMatrix(matrix)
    camera.UseExplicitProjectionTransformMatrixOn()


def place(prop: vtkProp, T_eye: SE3) -> None:
    """Set the pose of a prop in a perspective layer, in eye coordinates."""
    matrix = vtkMatrix4x4()
    matrix.DeepCopy(T_eye.matrix().ravel().tolist())
    prop.SetUserMatrix(matrix)  # type: ignore[attr-defined]


class Drawing:
    """Strokes as a prop of a 2D layer."""

    def __init__(self, renderer: vtkRenderer) -> None:
        self._polydata = vtkPolyData()
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(self._polydata)
        self.actor = vtkActor()
        self.actor.SetMapper(mapper)
        self.actor.GetProperty().LightingOff()
        self.actor.ForceTranslucentOn()
        self.actor.VisibilityOff()
        renderer.AddActor(self.actor)

    def show(self, strokes: Strokes) -> None:
        """Replace the drawn strokes."""
        points, colors, faces = strokes.arrays()
        self.actor.SetVisibility(len(faces) > 0)
        if len(faces):
            flat = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
            fill(self._polydata, flat, faces, colors)


def fill(
    polydata: vtkPolyData,
    points: NDArray[np.floating],
    faces: NDArray[np.integer],
    colors: NDArray[np.uint8] | None = None,
) -> None:
    """Replace the triangles of a polydata; points (V, 3), faces (F, 3), colours (V, 3 or 4)."""
    vertices = vtkPoints()
    vertices.SetData(numpy_to_vtk(np.ascontiguousarray(points, np.float32), deep=True))
    cells = vtkCellArray()
    flat = np.ascontiguousarray(faces, np.int64).ravel()
    cells.SetData(3, numpy_to_vtkIdTypeArray(flat, deep=True))
    polydata.SetPoints(vertices)
    polydata.SetPolys(cells)
    if colors is not None:
        polydata.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(colors), deep=True))
    polydata.Modified()


class Captions:
    """Text of one view; positions are relative to the top-left corner, physical pixels."""

    def __init__(self, layers: Layers) -> None:
        self._layers = layers
        self._actors: dict[str, vtkTextActor] = {}
        self._used: set[str] = set()

    def begin(self) -> None:
        """Start an update; texts not repeated by `say` until `end` are removed."""
        self._used = set()

    def end(self) -> None:
        for key, actor in self._actors.items():
            actor.SetVisibility(key in self._used)

    def texts(self) -> list[str]:
        """Return the current texts."""
        return [self._actors[key].GetInput() for key in sorted(self._used)]

    def say(
        self,
        key: str,
        text: str,
        at: tuple[float, float],
        *,
        size: float,
        color: tuple[float, float, float] = INK,
        paper: tuple[float, float, float] = PAPER,
        opacity: float = 0.62,
        align: str = "left",
        valign: str = "top",
    ) -> None:
        """Show a text on a box.

        Args:
            key: identifies the text; the same key replaces it.
            size: font size in physical pixels.
            align, valign: side or "center" of the text that is at `at`.
        """
        actor = self._actors.get(key)
        if actor is None:
            actor = vtkTextActor()
            actor.SetTextScaleModeToNone()
            self._layers.glass.AddViewProp(actor)
            self._actors[key] = actor
        self._used.add(key)
        if actor.GetInput() != text:
            actor.SetInput(text)
        style = actor.GetTextProperty()
        _set_style(style, size, color, paper, opacity, align, valign)
        _place(actor, at, self._layers.size[1])

    def close(self) -> None:
        for actor in self._actors.values():
            self._layers.glass.RemoveViewProp(actor)
        self._actors.clear()


def _set_style(
    style: vtkTextProperty,
    size: float,
    color: tuple[float, float, float],
    paper: tuple[float, float, float],
    opacity: float,
    align: str,
    valign: str,
) -> None:
    style.SetFontFamilyToArial()
    # VTK sizes are in points at 72 dots per inch.
    style.SetFontSize(round(size))
    style.SetColor(*color)
    style.SetBackgroundColor(*paper)
    style.SetBackgroundOpacity(opacity)
    style.SetLineSpacing(1.25)
    style.SetJustification({"left": 0, "center": 1, "right": 2}[align])
    style.SetVerticalJustification({"bottom": 0, "center": 1, "top": 2}[valign])


def _place(actor: vtkActor2D, at: tuple[float, float], height: int) -> None:
    # Whole pixels: fractional positions blur the text.
    actor.SetPosition(round(at[0]), round(height - at[1]))
