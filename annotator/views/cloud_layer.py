"""Rendering of the point cloud, the table plane and the cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

from annotator.views import clouds, projection, triangles
from annotator.views.layers import Layers, fill, place
from annotator.views.strokes import Color, Strokes
from std_toolkit.geometry import SE3, Camera

Array = NDArray[np.float64]

TABLE_COLOR = (0.45, 0.56, 0.68)
# Spacing of the table's grid lines.
_GRID_M = 0.05
_SMALLEST_TABLE_M = 0.25
_FRUSTUM_M = 0.07
# Smallest and largest point size, physical pixels; large points are too slow during motion.
POINT_PX = (2.0, 9.0)
LARGEST_LIGHT_PX = 4.0


class CloudLayer:
    """Point cloud of one view."""

    def __init__(self, layers: Layers) -> None:
        self._layers = layers
        self._cloud: clouds.Cloud | None = None
        self._T_eye: SE3 | None = None
        self._filled: set[bool] = set()
        # First in their layer, so that translucent meshes are drawn over them.
        self._actors = {few: _points_actor() for few in (False, True)}
        for actor in self._actors.values():
            layers.solids.AddActor(actor)

    def show(
        self, cloud: clouds.Cloud | None, T_eye: SE3 | None, *, light: bool, pixels_per_metre: float
    ) -> None:
        """Show a cloud at a pose, or none.

        Args:
            T_eye: coordinate frame of the points to eye coordinates.
            light: draw few points.
            pixels_per_metre: scale on the screen at the distance of the target.
        """
        self._T_eye = T_eye
        if cloud is not self._cloud:
            self._cloud = cloud
            self._filled = set()
        for actor in self._actors.values():
            actor.VisibilityOff()
        if cloud is None or T_eye is None or len(cloud.points) == 0:
            return
        few = light and len(cloud.points) > clouds.LIGHT_POINTS
        actor = self._actors[few]
        if few not in self._filled:
            self._filled.add(few)
            count = clouds.LIGHT_POINTS if few else len(cloud.points)
            mapper: Any = actor.GetMapper()
            mapper.SetInputData(_points(cloud.points[:count], cloud.colors[:count]))
        actor.VisibilityOn()
        # Large enough to close surfaces; fewer points are larger.
        spacing = cloud.spacing_m * (
            np.sqrt(len(cloud.points) / clouds.LIGHT_POINTS) if few else 1.0
        )
        size = 1.5 * spacing * pixels_per_metre
        smallest, largest = POINT_PX
        largest = LARGEST_LIGHT_PX if few else largest
        actor.GetProperty().SetPointSize(float(np.clip(size, smallest, largest)))
        place(actor, T_eye)

    def depth_at(self, camera: projection.ScreenCamera, xy: Array, *, reach: float) -> float | None:
        """Return the depth of the nearest point within `reach` pixels of a screen position."""
        if self._cloud is None or self._T_eye is None or len(self._cloud.points) == 0:
            return None
        points = self._T_eye @ self._cloud.points[: clouds.LIGHT_POINTS].astype(np.float64)
        with np.errstate(invalid="ignore"):
            near = np.abs(camera.project(points) - xy).max(axis=1) <= reach
        return float(points[near, 2].min()) if near.any() else None


class TableLayer:
    """Table plane of one view, drawn as a grid."""

    def __init__(self, layers: Layers) -> None:
        self._layers = layers
        self._key: object = None
        self._actors: list[vtkActor] = []

    def show(self, plane: tuple[Array, Array, float] | None, T_eye: SE3 | None) -> None:
        """Show a plane given by normal (3,), centre (3,) and radius in metres, or none."""
        for actor in self._actors:
            actor.SetVisibility(plane is not None and T_eye is not None)
        if plane is None or T_eye is None:
            return
        key = tuple(np.concatenate([plane[0], plane[1], [plane[2]]]).tolist())
        if key != self._key:
            self._key = key
            for actor in self._actors:
                self._layers.solids.RemoveActor(actor)
            self._actors = _table_actors(*plane)
            for actor in self._actors:
                self._layers.solids.AddActor(actor)
        for actor in self._actors:
            place(actor, T_eye)


def draw_camera(
    strokes: Strokes,
    screen: projection.ScreenCamera,
    T_eye_cam: SE3,
    camera: Camera,
    color: Color,
    *,
    scale: float = 1.0,
) -> Array | None:
    """Draw a frame's camera as a pyramid; returns its screen position, None if out of view."""
    w, h = camera.size
    corners = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    far = T_eye_cam @ (camera.unproject(corners) * _FRUSTUM_M)
    # A mark on the upper side shows the up direction.
    top = np.array([[0.35 * w, -0.5], [0.65 * w, -0.5], [0.5 * w, -0.16 * h]])
    mark = T_eye_cam @ (camera.unproject(top) * _FRUSTUM_M)
    ends = [(T_eye_cam.t, corner) for corner in far]
    ends += list(zip(far, np.roll(far, -1, axis=0), strict=True))
    ends += list(zip(mark, np.roll(mark, -1, axis=0), strict=True))
    points = np.array(ends)
    if (points[..., 2] <= 0.02).any():
        return None
    seen = screen.project(points)
    strokes.segments(seen, 3.2 * scale, (0.0, 0.0, 0.0, 0.4 * color[3]))
    strokes.segments(seen, 1.5 * scale, color)
    return screen.project(T_eye_cam.t)


def _points_actor() -> vtkActor:
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(vtkPolyData())
    actor = vtkActor()
    actor.SetMapper(mapper)
    actor.GetProperty().LightingOff()
    actor.VisibilityOff()
    return actor


def _points(points: NDArray[np.float32], colors: NDArray[np.uint8]) -> vtkPolyData:
    polydata = vtkPolyData()
    vertices = vtkPoints()
    vertices.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    polydata.SetPoints(vertices)
    cells = vtkCellArray()
    ids = np.arange(len(points), dtype=np.int64)
    # One cell with all points renders faster than one cell per point.
    cells.SetData(
        numpy_to_vtkIdTypeArray(np.array([0, len(points)], np.int64), deep=True),
        numpy_to_vtkIdTypeArray(ids, deep=True),
    )
    polydata.SetVerts(cells)
    polydata.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(colors), deep=True))
    return polydata


def _table_actors(normal: Array, middle: Array, radius: float) -> list[vtkActor]:
    radius = max(radius, _SMALLEST_TABLE_M)
    helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
    u = np.cross(normal, helper)
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    turn = 2 * np.pi * np.arange(96) / 96
    rim = middle + radius * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
    disc = vtkPolyData()
    at = np.arange(len(rim))
    fan = np.stack([np.full(len(rim), len(rim)), at, (at + 1) % len(rim)], axis=1)
    fill(disc, np.concatenate([rim, middle[None]]), fan)
    steps = np.arange(-int(radius / _GRID_M), int(radius / _GRID_M) + 1) * _GRID_M
    half = np.sqrt(np.maximum(radius**2 - steps**2, 0))
    ends = []
    for along, across in ((u, v), (v, u)):
        base = middle + steps[:, None] * across
        ends.append(np.stack([base - half[:, None] * along, base + half[:, None] * along], axis=1))
    ends.append(np.stack([rim, np.roll(rim, -1, axis=0)], axis=1))
    return [_flat_actor(disc, 0.10), _flat_actor(triangles.lines(np.concatenate(ends)), 0.45)]


def _flat_actor(polydata: vtkPolyData, opacity: float) -> vtkActor:
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(polydata)
    actor = vtkActor()
    actor.SetMapper(mapper)
    paint = actor.GetProperty()
    paint.LightingOff()
    paint.SetColor(*TABLE_COLOR)
    paint.SetOpacity(opacity)
    return actor
