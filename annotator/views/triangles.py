"""Triangle geometry: surfaces, their textures, decimation and silhouettes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import (
    numpy_to_vtk,
    numpy_to_vtkIdTypeArray,
    vtk_to_numpy,
)
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkImageData, vtkPolyData
from vtkmodules.vtkFiltersCore import (
    vtkPolyDataNormals,
    vtkQuadricClustering,
    vtkQuadricDecimation,
)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Number of wireframe sections across the longest side of the bounding box.
SECTIONS = 9

# Decimating larger meshes takes seconds; vertex clustering reduces them first.
_FACES_TO_DECIMATE = 80_000

# Texels across a texture for each pixel across an object: its surface is laid out around it.
_TEXELS_PER_PX = 2.5

# Edges with a larger angle are creases with split normals.
CREASE_DEG = 40.0


class Texture:
    """A texture image in resolutions that are halves of each other.

    Args:
        image: (H, W, 3) RGB; the first row is at v = 1.
        mipmaps: whether averages of neighbouring texels belong to neighbouring surface.
    """

    def __init__(self, image: Image, *, mipmaps: bool = True) -> None:
        self.image, self.mipmaps = image, mipmaps
        self._levels: dict[int, vtkImageData] = {}

    def level(self, pixels: float, last: int | None) -> int:
        """Return the number of halvings for an object of a size on the screen.

        Args:
            pixels: size of the object on the screen.
            last: the previous answer, which is kept if it is fine enough and not far too fine.
        """
        if not self.mipmaps:
            return 0
        fitting = max(self.image.shape[:2]) / max(_TEXELS_PER_PX * pixels, 64.0)
        level = max(int(np.floor(np.log2(max(fitting, 1.0)))), 0)
        return last if last is not None and level - 1 <= last <= level else level

    def data(self, level: int) -> vtkImageData:
        """Return the image after so many halvings."""
        if level not in self._levels:
            image = self.image
            if level:
                height, width = image.shape[:2]
                size = (max(width >> level, 1), max(height >> level, 1))
                image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
            height, width = image.shape[:2]
            data = vtkImageData()
            data.SetDimensions(width, height, 1)
            # VTK's first row is at v = 0.
            flat = np.ascontiguousarray(image[::-1]).reshape(-1, 3)
            data.GetPointData().SetScalars(numpy_to_vtk(flat, deep=True))
            self._levels[level] = data
        return self._levels[level]


@dataclass(frozen=True, eq=False)
class ColoredMesh:
    """Triangles with colours.

    Attributes:
        polydata: triangles with texture coordinates, or with colours as scalars.
        texture: None for scalars.
        by_face: whether the scalars belong to the faces instead of the vertices.
    """

    polydata: vtkPolyData
    texture: Texture | None
    by_face: bool = False


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
