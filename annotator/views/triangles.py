"""Triangle geometry: surfaces, their decimation and silhouettes, and antialiased 2D strokes.

Stroke edges fade out over a pixel, so antialiasing needs no driver support or multisampling.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vtkmodules.util.numpy_support import (
    numpy_to_vtk,
    numpy_to_vtkIdTypeArray,
    vtk_to_numpy,
)
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkFiltersCore import (
    vtkPolyDataNormals,
    vtkQuadricClustering,
    vtkQuadricDecimation,
)

if TYPE_CHECKING:
    from annotator.views.mesh_colors import ColoredMesh

Array = NDArray[np.float64]

# Number of wireframe sections across the longest side of the bounding box.
SECTIONS = 9

# Decimating larger meshes takes seconds; vertex clustering reduces them first.
_FACES_TO_DECIMATE = 80_000

# Edges with a larger angle are creases with split normals.
CREASE_DEG = 40.0

Color = tuple[float, float, float, float]
"""Red, green, blue, opacity; each 0 to 1."""


class Surface:
    """Render triangles, and edges for silhouettes.

    Attributes:
        polydata: triangles with smooth normals; vertices are doubled at creases.
        colored: the same triangles with the colours of the mesh; None while it has none.
    """

    def __init__(self, polydata: vtkPolyData) -> None:
        self.polydata = polydata
        self.colored: ColoredMesh | None = None

    @property
    def faces(self) -> int:
        return int(self.polydata.GetNumberOfCells())

    @cached_property
    def corners(self) -> tuple[Array, NDArray[np.int64]]:
        """Unique vertices (V, 3), mesh frame, metres, and faces (F, 3) of them."""
        points = vtk_to_numpy(self.polydata.GetPoints().GetData())
        faces = vtk_to_numpy(self.polydata.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        # Vertices doubled at a crease or texture seam are bitwise equal.
        _, first, place = np.unique(
            np.ascontiguousarray(points, np.float32).view("V12").ravel(),
            return_index=True,
            return_inverse=True,
        )
        return points[first].astype(np.float64), place[faces].astype(np.int64)

    @cached_property
    def planes(self) -> Array:
        """(F, 4) normal n and offset d of each face: n . p + d > 0 in front of it."""
        vertices, faces = self.corners
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        return np.concatenate([normals, -np.einsum("ij,ij->i", normals, a)[:, None]], axis=1)

    @cached_property
    def edges(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Vertices (E, 2) and faces (E, 2) of each edge; the second face is -1 at a border.

        An edge of three or more faces appears once for each pair of neighbours in the list.
        """
        _, faces = self.corners
        ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        face = np.repeat(np.arange(len(faces)), 3)
        real = ends[:, 0] != ends[:, 1]
        ends, face = ends[real], face[real]
        key = ends[:, 0] * (int(faces.max(initial=0)) + 1) + ends[:, 1]
        order = np.argsort(key, kind="stable")
        key, ends, face = key[order], ends[order], face[order]
        same = key[1:] == key[:-1]
        pairs = np.flatnonzero(same)
        alone = np.flatnonzero(~np.r_[same, False] & ~np.r_[False, same])
        index = np.r_[pairs, alone]
        second = np.r_[face[pairs + 1], np.full(len(alone), -1)]
        return ends[index], np.stack([face[index], second], axis=1)

    def silhouette(self, eye: Array) -> Array:
        """Return (S, 2, 3) edges between faces towards `eye` and away from it, mesh frame."""
        vertices, _ = self.corners
        ends, faces = self.edges
        front = self.planes[:, :3] @ eye + self.planes[:, 3] > 0
        turn = (faces[:, 1] < 0) | (front[faces[:, 0]] != front[faces[:, 1]])
        return vertices[ends[turn]]

    def creases(self) -> Array:
        """(S, 2, 3) sharp edges and borders, mesh frame."""
        vertices, _ = self.corners
        ends, faces = self.edges
        normals = self.planes[:, :3]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        unit = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
        cosine = np.einsum("ij,ij->i", unit[faces[:, 0]], unit[faces[:, 1]])
        flat = (length[faces] <= 0).any(axis=(1, 2))
        sharp = (faces[:, 1] < 0) | ((cosine < np.cos(np.deg2rad(CREASE_DEG))) & ~flat)
        return vertices[ends[sharp]]


def sections(surface: Surface, bounds: Array) -> Array:
    """Return (S, 2, 3) intersection lines of a surface with evenly spaced axis-aligned planes."""
    vertices, faces = surface.corners
    spacing = float((bounds[1] - bounds[0]).max()) / SECTIONS
    parts = [np.zeros((0, 2, 3))]
    for axis in range(3):
        middle, half = bounds.mean(axis=0)[axis], (bounds[1] - bounds[0])[axis] / 2
        count = int(half / spacing - 0.2)
        for level in middle + spacing * np.arange(-count, count + 1):
            # A vertex on the plane counts as above, so each face is cut at two edges or none.
            height = vertices[:, axis] - level
            above = height >= 0
            sides = above[faces]
            cut = faces[(sides.sum(axis=1) % 3) != 0]
            alone = above[cut].sum(axis=1) == 1
            # Start with the vertex that is alone on its side.
            lead = np.argmax(above[cut] == alone[:, None], axis=1)
            row = np.arange(len(cut))
            a = cut[row, lead]
            ends = []
            for step in (1, 2):
                b = cut[row, (lead + step) % 3]
                share = (height[a] / (height[a] - height[b]))[:, None]
                ends.append(vertices[a] + share * (vertices[b] - vertices[a]))
            parts.append(np.stack(ends, axis=1))
    return np.concatenate(parts)


def lines(ends: Array) -> vtkPolyData:
    """Return the polydata of separate lines (N, 2, 3)."""
    points = vtkPoints()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(ends.reshape(-1, 3), np.float32), deep=True))
    cells = vtkCellArray()
    cells.SetData(2, numpy_to_vtkIdTypeArray(np.arange(2 * len(ends), dtype=np.int64), deep=True))
    polydata = vtkPolyData()
    polydata.SetPoints(points)
    polydata.SetLines(cells)
    return polydata


def triangles(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> vtkPolyData:
    points = vtkPoints()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices, np.float32), deep=True))
    cells = vtkCellArray()
    cells.SetData(
        3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces, np.int64).ravel(), deep=True)
    )
    polydata = vtkPolyData()
    polydata.SetPoints(points)
    polydata.SetPolys(cells)
    return polydata


def with_normals(polydata: vtkPolyData) -> vtkPolyData:
    normals = vtkPolyDataNormals()
    normals.SetInputData(polydata)
    normals.SetFeatureAngle(CREASE_DEG)
    normals.SplittingOn()
    normals.ConsistencyOff()  # keeps the order of the faces
    normals.Update()
    return normals.GetOutput()


def lighter(polydata: vtkPolyData, faces: int) -> vtkPolyData:
    """Return a decimated copy with about N faces; the input if it has no more."""
    if polydata.GetNumberOfCells() <= faces:
        return polydata
    if polydata.GetNumberOfCells() > _FACES_TO_DECIMATE:
        clustering = vtkQuadricClustering()
        clustering.SetInputData(polydata)
        clustering.AutoAdjustNumberOfDivisionsOff()
        clustering.SetNumberOfDivisions(96, 96, 96)
        clustering.Update()
        polydata = clustering.GetOutput()
    decimation = vtkQuadricDecimation()
    decimation.SetInputData(polydata)
    decimation.SetTargetReduction(max(0.0, 1 - faces / polydata.GetNumberOfCells()))
    decimation.Update()
    return decimation.GetOutput()


# Width of the soft edge, pixels.
FADE_PX = 1.0


class Strokes:
    """Collects 2D shapes in drawing order; later ones are on top."""

    def __init__(self) -> None:
        self._points: list[Array] = []
        self._colors: list[NDArray[np.uint8]] = []
        self._faces: list[NDArray[np.int64]] = []
        self._count = 0

    def arrays(self) -> tuple[Array, NDArray[np.uint8], NDArray[np.int64]]:
        """Return vertices (V, 2) in screen positions, colours (V, 4) uint8, triangles (F, 3)."""
        if not self._points:
            return np.zeros((0, 2)), np.zeros((0, 4), np.uint8), np.zeros((0, 3), np.int64)
        return (
            np.concatenate(self._points),
            np.concatenate(self._colors),
            np.concatenate(self._faces),
        )

    def segments(self, ends: NDArray[np.floating], width: float, color: Color) -> None:
        """Add separate lines; `ends` (N, 2, 2) screen positions, `width` in pixels."""
        ends = ends[np.isfinite(ends).all(axis=(1, 2))]
        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along = np.divide(along, length, out=np.zeros_like(along), where=length > 1e-9)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        core = max((width - FADE_PX) / 2, 0.0)
        # Lines thinner than the soft edge are drawn with lower opacity.
        strength = min(1.0, width / FADE_PX)
        offsets = np.array([-core - FADE_PX, -core, core, core + FADE_PX])
        # (N, 2 ends, 4 across)
        grid = ends[:, :, None] + across[:, None, None] * offsets[:, None]
        alphas = np.tile(np.array([0.0, strength, strength, 0.0]), (len(ends), 2, 1))
        strip = [[0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 6], [2, 6, 3], [3, 6, 7]]
        faces = np.arange(len(ends))[:, None, None] * 8 + np.array(strip)
        self._add(grid.reshape(-1, 2), alphas.ravel(), color, faces.reshape(-1, 3))

    def line(self, points: ArrayLike, width: float, color: Color, *, closed: bool = False) -> None:
        """Add a polyline through `points` (N, 2), with mitred joints."""
        p = np.asarray(points, dtype=np.float64)
        p = p[np.isfinite(p).all(axis=1)]
        if len(p) < 2:
            return
        nexts = np.roll(p, -1, axis=0) if closed else np.concatenate([p[1:], p[-1:]])
        lasts = np.roll(p, 1, axis=0) if closed else np.concatenate([p[:1], p[:-1]])
        before, after = _unit(p - lasts), _unit(nexts - p)
        if not closed:
            before[0], after[-1] = after[0], before[-1]
        mitre = _unit(before + after)
        across = np.stack([-mitre[:, 1], mitre[:, 0]], axis=1)
        # Limits the mitre of sharp corners.
        stretch = 1 / np.clip(np.einsum("ij,ij->i", mitre, after), 0.4, 1.0)
        core = max((width - FADE_PX) / 2, 0.0)
        strength = min(1.0, width / FADE_PX)
        offsets = np.array([-core - FADE_PX, -core, core, core + FADE_PX])
        grid = p[:, None] + (across * stretch[:, None])[:, None] * offsets[:, None]
        alphas = np.tile(np.array([0.0, strength, strength, 0.0]), (len(p), 1))
        at = np.arange(len(p) if closed else len(p) - 1)
        a, b = 4 * at, 4 * ((at + 1) % len(p))
        faces = [
            np.stack(part, axis=1)
            for k in range(3)
            for part in ((a + k, b + k, a + k + 1), (a + k + 1, b + k, b + k + 1))
        ]
        self._add(grid.reshape(-1, 2), alphas.ravel(), color, np.concatenate(faces))

    def polygon(self, points: ArrayLike, color: Color) -> None:
        """Add a filled convex polygon (N, 2) with a soft edge."""
        p = np.asarray(points, dtype=np.float64)
        if len(p) < 3 or not np.isfinite(p).all():
            return
        middle = p.mean(axis=0)
        n = len(p)
        at = np.arange(n)
        fan = np.stack([np.full(n, n), at, (at + 1) % n], axis=1)
        self._add(np.concatenate([p, middle[None]]), np.ones(n + 1), color, fan)
        self.line(p, FADE_PX, color, closed=True)

    def disc(self, middle: ArrayLike, radius: float, color: Color) -> None:
        self.polygon(circle(middle, radius), color)

    def ring(self, middle: ArrayLike, radius: float, width: float, color: Color) -> None:
        self.line(circle(middle, radius), width, color, closed=True)

    def cross(self, middle: ArrayLike, size: float, width: float, color: Color) -> None:
        """Add an upright cross with a gap in the middle that shows the pixel."""
        x, y = np.asarray(middle, dtype=np.float64)
        near, far = 0.35 * size, size
        ends = [
            [[x + dx * near, y + dy * near], [x + dx * far, y + dy * far]]
            for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
        ]
        self.segments(np.array(ends), width, color)

    def _add(self, points: Array, alphas: Array, color: Color, faces: NDArray[np.integer]) -> None:
        rgba = np.empty((len(points), 4))
        rgba[:, :3] = color[:3]
        rgba[:, 3] = alphas * color[3]
        self._points.append(points)
        self._colors.append((255 * rgba).round().astype(np.uint8))
        self._faces.append(faces.astype(np.int64) + self._count)
        self._count += len(points)


def circle(middle: ArrayLike, radius: float) -> Array:
    """Return (N, 2) points of a circle on the screen, dense enough to look round."""
    n = int(np.clip(radius * 2, 16, 96))
    angle = 2 * np.pi * np.arange(n) / n
    ring: Array = np.asarray(middle, dtype=np.float64) + radius * np.stack(
        [np.cos(angle), np.sin(angle)], axis=1
    )
    return ring


def rgba(color: str | Sequence[float], opacity: float = 1.0) -> Color:
    """Return a colour "#rrggbb" or (r, g, b) with an opacity."""
    if isinstance(color, str):
        r, g, b = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    else:
        r, g, b = color
    return (r, g, b, opacity)


def _unit(v: Array) -> Array:
    length = np.linalg.norm(v, axis=1, keepdims=True)
    return np.divide(v, length, out=np.zeros_like(v), where=length > 1e-9)
