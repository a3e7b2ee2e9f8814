"""Colours of meshes for drawing: textures in several resolutions, and textures of decimated meshes.

A full mesh keeps its texture coordinates. A decimated one has lost them, so the colours of the full
mesh are sampled into a texture of its own, in which each triangle has a place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkPolyData

from annotator.views.triangles import ColoredMesh, Image, Texture, triangles
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.surface_colors import SurfaceColors

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

# Longer side to which a larger texture is reduced: 0.2 mm per texel on an object of 0.2 m.
LARGEST_PX = 2048

# Colours of a mesh that differ by less, in grey levels, are one colour.
_ONE_COLOR = 8.0

# Texels of the texture of a decimated mesh: about half a millimetre each on an object of 0.2 m.
_BAKED_TEXELS = 400_000
_CELLS_PX = tuple(2**k for k in range(2, 10))  # sides of the cells of two triangles
# Longer side of the texture from which they are sampled: a finer one would alias.
_SAMPLED_PX = 1024
# Texels sampled at a time; other threads wait for each batch.
_BATCH = 20_000
# Distance from the decimated mesh at which colours are sampled, as a fraction of its radius:
# outside, so that of a thin wall the outer side is taken.
_OUTSIDE = 0.005


def mesh_colors(mesh: trimesh.Trimesh, *, largest: int = LARGEST_PX) -> SurfaceColors | None:
    """Return the colours of a mesh; None without a texture or if they are all the same.

    Args:
        mesh: with a texture, vertex colours or face colours.
        largest: longer side to which a larger texture is reduced, pixels.
    """
    colors = SurfaceColors.from_mesh(mesh, largest=largest)
    return colors if colors is not None and _vary(colors) else None


def _vary(colors: SurfaceColors) -> bool:
    faces = len(colors.corners)
    rng = np.random.default_rng(0)
    face = np.arange(faces) if faces > 20_000 else np.resize(np.arange(faces), 20_000)
    weights = rng.dirichlet((0.7, 0.7, 0.7), len(face))[:, 1:]
    return bool(np.ptp(colors.at(face, weights), axis=0).max() > _ONE_COLOR)


def colored_mesh(polydata: vtkPolyData, colors: SurfaceColors) -> ColoredMesh:
    """Return a mesh with its own colours; `polydata` has the faces of `colors` in their order."""
    corners = colors.corners
    place = _faces(polydata).flatten()
    if colors.texture is None:
        copy = vtkPolyData()
        copy.ShallowCopy(polydata)
        by_face = bool((corners == corners[:, :1]).all())
        if by_face:
            copy.GetCellData().SetScalars(numpy_to_vtk(_bytes(corners[:, 0]), deep=True))
        else:
            values = np.zeros((polydata.GetNumberOfPoints(), 3), np.uint8)
            values[place] = _bytes(corners.reshape(-1, 3))
            copy.GetPointData().SetScalars(numpy_to_vtk(values, deep=True))
        return ColoredMesh(copy, None, by_face)
    uv = np.zeros((polydata.GetNumberOfPoints(), 2), np.float32)
    uv[place] = corners.reshape(-1, 2)
    # At the border of a patch of the texture a vertex has several coordinates: double it.
    other = np.flatnonzero((uv[place] != corners.reshape(-1, 2)).any(axis=1))
    vertex = np.concatenate([np.arange(len(uv)), place[other]])
    place[other] = len(uv) + np.arange(len(other))
    uv = np.concatenate([uv, corners.reshape(-1, 2)[other]])
    copy = _with_texture(polydata, vertex, place.reshape(-1, 3), uv)
    return ColoredMesh(copy, Texture(_bytes(colors.texture)))


def baked_mesh(
    polydata: vtkPolyData, vertices: Array, faces: NDArray[np.integer], colors: SurfaceColors
) -> ColoredMesh:
    """Return a decimated mesh with the colours of the full one.

    Args:
        polydata: the decimated mesh with normals.
        vertices, faces: the full mesh, (V, 3) metres and (F, 3).
        colors: of the full mesh.
    """
    if colors.texture is not None:
        colors = colors.reduced(_SAMPLED_PX / max(colors.texture.shape[:2]))
    corner = _faces(polydata)
    points = vtk_to_numpy(polydata.GetPoints().GetData()).astype(np.float64)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    points = points - centre
    # The corner opposite to the longest edge comes first: it gets the right angle of the place.
    edges = points[np.roll(corner, -1, axis=1)] - points[np.roll(corner, -2, axis=1)]
    lengths = np.linalg.norm(edges, axis=2)
    turn = (np.argmax(lengths, axis=1)[:, None] + np.arange(3)) % 3
    corner = np.take_along_axis(corner, turn, axis=1)
    xyz = points[corner]
    cells, places = _atlas(xyz)

    caster = RayCaster(vertices - centre, faces, threads=1)
    normals = np.cross(xyz[:, 1] - xyz[:, 0], xyz[:, 2] - xyz[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    outside = _OUTSIDE * float(np.linalg.norm(points, axis=1).max()) * normals
    image = np.full((*places.shape, 3), 128, np.uint8)
    uv = np.zeros((len(corner), 3, 2), np.float32)
    for size in np.unique(cells):
        texels, weights, ends = _cell(int(size))
        for half in (0, 1):
            chosen = np.flatnonzero((cells == size) & (places.half == half))
            if not len(chosen):
                continue
            origin = places.origin[chosen]
            uv[chosen] = (origin[:, None] + ends[half] + 0.5) / places.shape[::-1]
            step = max(_BATCH // len(weights), 1)
            for first in range(0, len(chosen), step):
                some = chosen[first : first + step]
                at = np.einsum("tk,fkd->ftd", weights, xyz[some]) + outside[some, None]
                face, where = caster.closest_faces(at.reshape(-1, 3))
                column, row = (places.origin[some, None] + texels[half]).reshape(-1, 2).T
                image[row, column] = _bytes(colors.at(face, where))
    uv[..., 1] = 1 - uv[..., 1]
    every = np.arange(corner.size).reshape(-1, 3)
    copy = _with_texture(polydata, corner.ravel(), every, uv.reshape(-1, 2))
    return ColoredMesh(copy, Texture(image, mipmaps=False))


@dataclass(frozen=True, eq=False)
class _Places:
    """Places of N triangles in a texture.

    Attributes:
        shape: rows and columns of the texture.
        origin: (N, 2) column and row of the cell's first texel.
        half: (N,) which half of the cell, 0 or 1.
    """

    shape: tuple[int, int]
    origin: NDArray[np.int64]
    half: NDArray[np.int64]


def _atlas(xyz: Array) -> tuple[NDArray[np.int64], _Places]:
    """Return the sides (N,) of the triangles' cells in texels, and their places."""
    legs = np.linalg.norm(xyz[:, 1:] - xyz[:, :1], axis=2).max(axis=1)
    sizes = np.array(_CELLS_PX)
    pitch = max(float(legs.max()), 1e-9) / 500
    while True:
        index = np.searchsorted(sizes - 3, np.minimum(legs / pitch, sizes[-1] - 3))
        cells = sizes[index]
        if (cells**2).sum() / 2 <= _BAKED_TEXELS or index.max() == 0:
            break
        pitch *= 1.2
    order = np.argsort(-cells, kind="stable")
    # Two triangles of one size share a cell; cells of falling size fill a Z-order curve, on which
    # every aligned square of a power of two is contiguous.
    origin, half = np.zeros((len(cells), 2), np.int64), np.zeros(len(cells), np.int64)
    used = 0
    for size in sizes[::-1]:
        chosen = order[cells[order] == size]
        if not len(chosen):
            continue
        number = np.arange(len(chosen))
        half[chosen] = number % 2
        start = used + (number // 2) * int(size) ** 2
        origin[chosen] = np.stack(_z_order(start), axis=1)
        used += ((len(chosen) + 1) // 2) * int(size) ** 2
    side = 1 << int(np.ceil(np.log2(max(used, 1)) / 2))
    # The first half of the curve fills the upper half of the square.
    rows = side if used > side * side // 2 else max(side // 2, 1)
    return cells, _Places((rows, side), origin, half)


def _z_order(number: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return column and row of positions on the Z-order curve."""
    column, row = np.zeros_like(number), np.zeros_like(number)
    for bit in range(16):
        column |= ((number >> (2 * bit)) & 1) << bit
        row |= ((number >> (2 * bit + 1)) & 1) << bit
    return column, row


def _cell(size: int) -> tuple[list[NDArray[np.int64]], Array, list[Array]]:
    """Return the texels of a cell's two halves, their weights, and the positions of the corners.

    The legs of the triangles are `size` - 3 texels long, so that interpolation within one triangle
    takes no texel of the other.

    Returns:
        Columns and rows (T, 2) for each half; (T, 3) barycentric weights; corners (3, 2) for each
        half, in texels from the centre of the cell's first one.
    """
    leg = size - 3
    column, row = np.meshgrid(np.arange(size), np.arange(size))
    own = column + row <= size - 2
    texels = np.stack([column[own], row[own]], axis=1)
    b, c = texels[:, 0] / leg, texels[:, 1] / leg
    corners = np.array([[0.0, 0.0], [leg, 0.0], [0.0, leg]])
    return (
        [texels, size - 1 - texels],
        np.stack([1 - b - c, b, c], axis=1),
        [corners, size - 1 - corners],
    )


def _with_texture(
    polydata: vtkPolyData,
    vertex: NDArray[np.int64],
    faces: NDArray[np.int64],
    uv: NDArray[np.float32],
) -> vtkPolyData:
    """Return a mesh of the vertices (V,) of another, faces (F, 3) of these, and their uv (V, 2)."""
    points = vtk_to_numpy(polydata.GetPoints().GetData())[vertex]
    normals = vtk_to_numpy(polydata.GetPointData().GetNormals())[vertex]
    copy = triangles(points, faces)
    copy.GetPointData().SetNormals(numpy_to_vtk(normals, deep=True))
    copy.GetPointData().SetTCoords(numpy_to_vtk(uv, deep=True))
    return copy


def _faces(polydata: vtkPolyData) -> NDArray[np.int64]:
    connectivity = vtk_to_numpy(polydata.GetPolys().GetConnectivityArray())
    return np.asarray(connectivity, dtype=np.int64).reshape(-1, 3)


def _bytes(values: NDArray[np.floating]) -> Image:
    return np.ascontiguousarray(np.clip(np.rint(values), 0, 255), np.uint8)
