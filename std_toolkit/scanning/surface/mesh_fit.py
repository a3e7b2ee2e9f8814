"""The mesh of a scan as depth maps, outlines and smoothness hold it, by Gauss-Newton steps.

In each step, vertices move along their normals. The sum of three terms is least: their distances
from where depth maps have them, from the outlines on whose rim they are, and the deviation of the
faces from filtered normals (X. Sun et al., "Fast and Effective Feature-Preserving Mesh Denoising",
TVCG 2007; Y. Zheng et al., "Bilateral Normal Filtering for Mesh Denoising", TVCG 2011). The filter
keeps edges. Where nothing is measured, the surface goes on evenly from what is around it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import cg

from std_toolkit.arrays import Array, Floats
from std_toolkit.geometry import SE3
from std_toolkit.geometry.crossing_faces import without_crossings
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.photos.visibility import vertex_normals
from std_toolkit.scanning.surface.depth_maps import DepthMap
from std_toolkit.scanning.surface.vertex_moves import depth_moves, outline_moves, visible_vertices
from std_toolkit.settings import Settings, limit

_STEPS = 4
# Times that the normals of all faces are averaged in a step.
_AVERAGED = 5
# Largest move of a vertex in a step, in voxels.
_FARTHEST = 2.2


@dataclass(frozen=True, kw_only=True)
class MeshFitSettings(Settings):
    """Weights of the terms that hold a mesh."""

    smooth: float = limit(2.0, source="perf/scan.py on the real bottle, a box and a can")
    """weight of filtered normals against one depth measurement"""
    rest: float = limit(0.02, source="less than any measurement")
    """weight of the place of a vertex before the step"""
    most_depth: float = limit(4.0, source="photos from nearly the same place err alike")
    """largest weight of all depth measurements of a vertex"""
    most_outline: float = limit(2.0, source="as above, for outlines")
    """largest weight of all outlines of a vertex"""
    many: float = limit(48.0, source="photos around an object that show each outline twice")
    """number of photos from which outlines count as single measurements"""
    edge: float = limit(0.45, source="26 degrees: noise is less, an edge more")
    """difference of unit normals from which faces count as parts of different sides"""


def fit_mesh(
    vertices: Array,
    faces: NDArray[np.int64],
    views: Sequence[View],
    layers: Sequence[Sequence[DepthMap | None]],
    weights: Sequence[Floats],
    *,
    step: float,
    floors: Sequence[SE3] = (),
    threads: int = 1,
) -> Array:
    """Vertices (V, 3) moved to where measurements and smoothness hold them.

    Args:
        vertices: (V, 3) world, within a few voxels of the surface.
        faces: (F, 3) of a closed mesh.
        views: photos with masks.
        layers: depth maps, one for each photo in each of the layers.
        weights: of their pixels, layer by layer, as of `surface.agreeing`.
        step: size of a voxel of the surface that the mesh is from, metres.
        floors: motions whose z = 0 is a table, below which no vertex is moved.
        threads: number of threads.
    """
    limits = MeshFitSettings.current()
    start = vertices = without_crossings(vertices, faces)
    pairs = _neighbours(faces, len(vertices))
    normals = vertex_normals(vertices, faces)
    seen = visible_vertices(vertices, faces, normals, views, threads=threads)
    maps = [(views[i], m, seen[i]) for layer in layers for i, m in enumerate(layer)]
    rim = np.zeros(len(vertices)), np.zeros(len(vertices))
    for n in range(_STEPS):
        normals = vertex_normals(vertices, faces)
        depth, sure = depth_moves(vertices, normals, maps, weights, step)
        sure = np.minimum(sure, limits.most_depth)
        # The outline of the mesh is drawn anew for every second step.
        drawn = n % 2 == 0
        if drawn:
            rim = outline_moves(vertices, faces, normals, views, threads=threads)
        # Each outline of few photos is the only one of its place.
        alone = max(1.0, limits.many / len(views))
        held = np.minimum(rim[1], limits.most_outline) * alone**2
        # An outline that was followed once holds the vertex where it is.
        asked = rim[0] if drawn else np.zeros(len(vertices))
        wanted = filtered_normals(vertices, faces, pairs, edge=limits.edge)
        move = _step(vertices, faces, normals, wanted, sure * depth + held * asked, sure + held)
        move = np.clip(move, -_FARTHEST * step, _FARTHEST * step)
        vertices = vertices + move[:, None] * normals
        vertices = above_floors(vertices + _even(vertices, faces, wanted), floors)
    return without_crossings(vertices, faces, start)


def above_floors(vertices: Array, floors: Sequence[SE3]) -> Array:
    """Vertices (V, 3), those below the plane z = 0 of a moved world lifted to it."""
    for T in floors:
        up = T.R[:, 2]
        vertices = vertices - np.minimum((vertices - T.t) @ up, 0)[:, None] * up
    return vertices


def _step(
    vertices: Array, faces: NDArray[np.int64], normals: Array, wanted: Array, pull: Array,
    weight: Array,
) -> Array:  # fmt: skip
    """Moves (V,) along the normals, metres: `pull` is weight times wanted move, and the sides of
    each face should be across its wanted normal."""
    limits = MeshFitSettings.current()
    rows = np.arange(3 * len(faces))
    i, j = faces.T.ravel(), np.roll(faces, -1, axis=1).T.ravel()
    n = np.tile(wanted, (3, 1))
    values = [(n * normals[i]).sum(axis=1), -(n * normals[j]).sum(axis=1)]
    place = np.concatenate([rows, rows]), np.concatenate([i, j])
    A = coo_matrix((np.concatenate(values), place), shape=(len(rows), len(vertices))).tocsr()
    off = -(n * (vertices[i] - vertices[j])).sum(axis=1)
    H = limits.smooth * (A.T @ A) + diags(weight + limits.rest)
    found, _ = cg(
        H, limits.smooth * (A.T @ off) + pull, M=diags(1 / H.diagonal()), rtol=1e-5, maxiter=400
    )
    return np.asarray(found)


def filtered_normals(
    vertices: Array, faces: NDArray[np.int64], pairs: tuple[Array, Array], *, edge: float
) -> Array:
    """(F, 3) unit normals of the faces, averaged over neighbours that face nearly the same way.

    Args:
        vertices: (V, 3).
        faces: (F, 3).
        pairs: faces (P,) and (P,) that have a vertex in common.
        edge: difference of unit normals above which they are hardly averaged.
    """
    middle, normal, area = _of_faces(vertices, faces)
    i, j = pairs
    apart = ((middle[i] - middle[j]) ** 2).sum(axis=1)
    near = area[j] * np.exp(-apart / (2 * apart.mean() + 1e-20))
    for _ in range(_AVERAGED):
        turned = ((normal[i] - normal[j]) ** 2).sum(axis=1)
        w = near * np.exp(-turned / (2 * edge**2))
        total = area[:, None] * normal
        for k in range(3):
            total[:, k] += np.bincount(i, w * normal[j, k], minlength=len(faces))
        normal = total / (np.linalg.norm(total, axis=1, keepdims=True) + 1e-20)
    return np.asarray(normal)


def _of_faces(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Middles (F, 3), unit normals (F, 3) and areas (F,) of faces."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(cross, axis=1)
    return corners.mean(axis=1), cross / (double[:, None] + 1e-20), double / 2


def _neighbours(faces: NDArray[np.int64], count: int) -> tuple[Array, Array]:
    """Pairs of different faces that have a vertex in common, each in both orders."""
    owner = np.repeat(np.arange(len(faces)), 3)
    place = owner, faces.ravel()
    corners = coo_matrix((np.ones(len(owner)), place), shape=(len(faces), count)).tocsr()
    both = (corners @ corners.T).tocoo()
    different = both.row != both.col
    return both.row[different], both.col[different]


def _even(vertices: Array, faces: NDArray[np.int64], normals: Array) -> Array:
    """(V, 3) moves within the surface that even out its faces: along edges, and not at corners."""
    count = len(vertices)
    total, around = np.zeros((count, 3)), np.zeros(count)
    spread = np.zeros((count, 3, 3))
    area = _of_faces(vertices, faces)[2]
    outer = area[:, None, None] * normals[:, :, None] * normals[:, None, :]
    for k in range(3):
        np.add.at(total, faces[:, k], vertices[faces[:, (k + 1) % 3]])
        np.add.at(around, faces[:, k], 1)
        np.add.at(spread, faces[:, k], outer)
    move = total / np.maximum(around, 1)[:, None] - vertices
    size, axis = np.linalg.eigh(spread)
    # Directions in which the normals around a vertex point are across the surface.
    free = np.clip(1 - size / (0.1 * size[:, -1:] + 1e-20), 0, 1)
    along = np.einsum("vij,vi->vj", axis, move) * free
    return np.asarray(0.4 * np.einsum("vij,vj->vi", axis, along))
