"""Polish of a mesh: vertices on the rim of a photo move along their normals to its outline."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags

from std_toolkit.arrays import Array
from std_toolkit.geometry import SE3
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.masks.hull import outline_distance
from std_toolkit.scanning.photos.views import View, in_threads
from std_toolkit.scanning.photos.visibility import hull_depth, vertex_normals
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class RimSettings(Settings):
    """Which vertices are on the rim of a photo."""

    rim_px: float = limit(1.0, unit="px", source=NOT_RECORDED)
    """a vertex on the rim projects this near to the outline of the mesh"""
    across: float = limit(0.45, source=NOT_RECORDED)
    """and its normal is this nearly across the ray (sine)"""
    farthest_px: float = limit(5.0, unit="px", source=NOT_RECORDED)
    """outlines further away belong to something else"""


def fit_outlines(
    vertices: Array,
    faces: NDArray[np.int64],
    views: Sequence[View],
    support: NDArray[np.floating],
    *,
    average: Any,
    floors: Sequence[SE3] = (),
    rounds: int = 3,
    threads: int = 1,
) -> Array:
    """Vertices (V, 3) moved so that the outlines of the mesh fit those of the masks.

    Args:
        vertices: (V, 3) world.
        faces: (F, 3) of a closed mesh.
        views: photos with masks.
        support: (V,) weight of the depth measurements of each vertex; they hold it in its place.
        average: of `averaging`.
        floors: motions whose z = 0 is a table, below which no vertex is moved.
        rounds: number of repetitions.
        threads: number of threads.
    """
    wanted = [outline_distance(v.possible) / 32.0 for v in views]
    borders = [_known(v) for v in views]
    for _ in range(rounds):
        caster = RayCaster(vertices, faces, threads=1)
        normals = vertex_normals(vertices, faces)

        def one(
            i: int, caster: RayCaster = caster, at: Array = vertices, normals: Array = normals
        ) -> tuple[Array, Array]:
            return _moves(views[i], wanted[i], borders[i], caster, at, normals)

        found = in_threads(one, range(len(views)), threads=threads)
        total = np.sum([m for m, _ in found], axis=0)
        weight = np.sum([w for _, w in found], axis=0)
        # Spread over the neighbours, so that the rim does not become a ridge.
        for _ in range(3):
            total, weight = average @ total, average @ weight
        # An outline is a measurement of its photo, as depth is: both count by their weights.
        move = 0.8 * total / np.maximum(weight + support, 0.05)
        vertices = above_floors(vertices + move[:, None] * normals, floors)
    return vertices


def above_floors(vertices: Array, floors: Sequence[SE3]) -> Array:
    """Vertices (V, 3), those below the plane z = 0 of a moved world lifted to it."""
    for T in floors:
        up = T.R[:, 2]
        vertices = vertices - np.minimum((vertices - T.t) @ up, 0)[:, None] * up
    return vertices


def _moves(
    view: View,
    wanted: NDArray[np.floating],
    known: NDArray[np.bool_],
    caster: RayCaster,
    vertices: Array,
    normals: Array,
) -> tuple[Array, Array]:
    """Sum of the wanted moves along the normal (V,), metres, and their weights (V,)."""
    limits = RimSettings.current()
    whole = (0, 0, view.camera.width, view.camera.height)
    drawn = hull_depth(view, caster, np.zeros(3), whole)[0] > 0
    rim = outline_distance(drawn) / 32.0
    uv, z = view.project(vertices)
    uv = np.where(np.isfinite(uv), uv, -10)
    x, y = np.rint(uv.T).astype(np.int64)
    inside = (x >= 1) & (y >= 1) & (x < whole[2] - 1) & (y < whole[3] - 1)
    move, weight = np.zeros(len(vertices)), np.zeros(len(vertices))
    index = np.flatnonzero(inside)
    x, y = x[index], y[index]
    ray = vertices[index] - view.centre
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    across = np.abs((ray * normals[index]).sum(axis=1))
    off = wanted[y, x]
    use = (
        (np.abs(rim[y, x]) < limits.rim_px)
        & (across < limits.across)
        & (np.abs(off) < limits.farthest_px)
    )
    use &= known[y, x]
    kept = index[use]
    # The mesh's own outline is not quite at its vertices.
    difference = (rim[y, x] - off)[use]
    move[kept] = difference * z[kept] / view.camera.fx
    weight[kept] = 1.0
    return move, weight


def _known(view: View) -> NDArray[np.bool_]:
    """Pixels where the outline of the mask is that of the object."""
    h, w = view.image.shape[:2]
    known = np.zeros((h, w), bool)
    known[6 : h - 6, 6 : w - 6] = True
    if view.hidden is not None:
        from std_toolkit.scanning.masks.masks import dilated

        known &= ~dilated(view.hidden, 6)
    return known


def averaging(faces: NDArray[np.int64], count: int) -> coo_matrix:
    """Sparse matrix that averages values of vertices over their neighbours and themselves."""
    i = np.concatenate([faces[:, 0], faces[:, 1], faces[:, 2], np.arange(count)])
    j = np.concatenate([faces[:, 1], faces[:, 2], faces[:, 0], np.arange(count)])
    both = coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count)).tocsr()
    both = ((both + both.T) > 0).astype(np.float64)
    return diags(1 / np.asarray(both.sum(axis=1)).ravel()) @ both
