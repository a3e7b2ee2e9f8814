"""An asset as renderers take it: one normal per vertex, edges sharp, round parts smooth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.assets.asset import Asset

Array = NDArray[np.float64]
# A ring of 16 sides is smooth, one of 8 has edges.
CREASE = np.radians(33.0)
# Height of triangles whose direction is lost in the rounding of canonical coordinates to float32.
_SLIVER = 3e-6


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles whose vertices are split where normal or texture coordinate change abruptly.

    Attributes:
        vertices: (N, 3) canonical coordinates.
        normals: (N, 3) unit normals.
        faces: (F, 3) vertex indices, in the order of the asset's faces less those without area.
        uv: (N, 2) texture coordinates, or None.
        face_colors: (F, 3) uint8 RGB, or None.
        source_vertex: (N,) vertex of the asset that each came from.
    """

    vertices: Array
    normals: Array
    faces: NDArray[np.int64]
    uv: NDArray[np.float32] | None
    face_colors: NDArray[np.uint8] | None
    source_vertex: NDArray[np.int64]


def render_surface(asset: Asset, *, crease: float = CREASE) -> Surface:
    """Split an asset's vertices for smooth shading.

    Args:
        crease: faces that meet at a larger angle keep an edge between them, radians.
    """
    faces = asset.faces
    normal, area = _face_normals(asset.vertices, faces)
    kept = area > 0
    faces, normal, area = faces[kept], normal[kept], area[kept]
    corners = corner_normals(asset.vertices, faces, normal, area, crease)
    uv = None if asset.corner_uv is None else asset.corner_uv[kept].reshape(-1, 2)
    # Corners are one vertex if all that they carry is equal, to a digit that no eye sees.
    key = [faces.reshape(-1, 1), np.round(corners.reshape(-1, 3) * 1e4).astype(np.int64)]
    if uv is not None:
        key.append(np.round(uv * 1e5).astype(np.int64))
    _, first, index = np.unique(
        np.concatenate(key, axis=1), axis=0, return_index=True, return_inverse=True
    )
    source = faces.reshape(-1)[first]
    return Surface(
        vertices=asset.vertices[source],
        normals=corners.reshape(-1, 3)[first],
        faces=index.reshape(-1, 3).astype(np.int64),
        uv=None if uv is None else uv[first],
        face_colors=None if asset.face_colors is None else asset.face_colors[kept],
        source_vertex=source,
    )


def corner_normals(
    vertices: Array, faces: NDArray[np.int64], normal: Array, area: Array, crease: float
) -> Array:
    """(F, 3, 3) normal at each face's corners: of the faces round the vertex that lie smooth to it.

    Args:
        normal: (F, 3) of the faces, unit length.
        area: (F,).
        crease: largest angle between smooth faces, radians.

    Each face counts with its angle at the vertex, so that a fan of slivers weighs no more than the
    piece of surface that it is.
    """
    count = len(faces)
    weight = _corner_angles(vertices, faces).reshape(-1)
    # A sliver's normal is rounding noise: it takes its neighbours', and gives them nothing.
    sliver = 2 * area < _SLIVER * _longest_edge(vertices, faces)
    weight = np.where(np.repeat(sliver, 3), 1e-9, weight)
    corner_vertex = faces.reshape(-1)
    order = np.argsort(corner_vertex, kind="stable")
    sizes = np.bincount(corner_vertex, minlength=len(vertices))
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    total = np.zeros((3 * count, 3))
    smooth = np.cos(crease)
    # Vertices of the same number of faces at a time: all their pairs of corners at once.
    for size in np.unique(sizes[sizes > 0]):
        mine = np.flatnonzero(sizes == size)
        for block in np.array_split(mine, max(1, len(mine) * int(size) ** 2 // 2_000_000)):
            corner = order[starts[block][:, None] + np.arange(size)]
            n, w = normal[corner // 3], weight[corner]
            near = np.einsum("bid,bjd->bij", n, n) >= smooth
            near |= sliver[corner // 3][:, :, None]
            total[corner] = np.einsum("bij,bj,bjd->bid", near, w, n)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    flat = np.repeat(normal, 3, axis=0)
    unit = np.where(length > 1e-12, total / np.maximum(length, 1e-12), flat)
    return unit.reshape(count, 3, 3)


def _face_normals(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, Array]:
    """Unit normals (F, 3) and areas (F,)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, 1e-300)[:, None], length / 2


def _longest_edge(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """(F,) length of each face's longest edge."""
    edges = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
    return np.linalg.norm(edges, axis=2).max(axis=1)


def _corner_angles(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """(F, 3) angle of each face at its corners, radians."""
    p = vertices[faces]
    to_next, to_last = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    cross = np.linalg.norm(np.cross(to_next, to_last), axis=2)
    return np.arctan2(cross, np.einsum("fkd,fkd->fk", to_next, to_last))
