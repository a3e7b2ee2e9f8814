"""How far vertices of a mesh should move along their normals, by depth maps and by outlines."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags

from std_toolkit.arrays import Array, Floats
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.masks.hull import outline_distance
from std_toolkit.scanning.masks.masks import dilated
from std_toolkit.scanning.photos.views import View, in_threads
from std_toolkit.scanning.photos.visibility import depth_of, hull_depth, seen_from
from std_toolkit.scanning.surface.depth_maps import DepthMap
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Rounds of the robust mean of the depth measurements of a vertex.
_ROUNDS = 6
# Pixels beside the border of a photo and beside what hides the object, where outlines say nothing.
_BESIDE_PX = 6


@dataclass(frozen=True, kw_only=True)
class VertexMoveSettings(Settings):
    """Which measurements are of a vertex."""

    nearest_voxels: float = limit(4.0, unit="voxels", source="as depth maps are fused")
    """depth further from the vertex is of another surface"""
    spread_voxels: float = limit(0.7, unit="voxels", source="the real bottle: photos agree so far")
    """deviation from the others from which a measurement loses its weight"""
    facing: float = limit(0.3, source=NOT_RECORDED)
    """smallest cosine between the normal of a measurement and that of the vertex"""
    rim_px: float = limit(1.0, unit="px", source=NOT_RECORDED)
    """a vertex on the rim projects this near to the outline of the mesh"""
    across: float = limit(0.45, source=NOT_RECORDED)
    """and its normal is this nearly across the ray (sine)"""
    farthest_px: float = limit(5.0, unit="px", source=NOT_RECORDED)
    """outlines further away belong to something else"""


def visible_vertices(
    vertices: Array, faces: NDArray[np.int64], normals: Array, views: Sequence[View],
    *, threads: int = 1,
) -> list[NDArray[np.int64]]:  # fmt: skip
    """Indices of the vertices (V, 3) that each photo shows from the front."""
    caster = RayCaster(vertices, faces, threads=1)

    def one(view: View) -> NDArray[np.int64]:
        return np.flatnonzero(seen_from(view, vertices, normals, depth_of(view, caster))[1] > 0)

    return in_threads(one, views, threads=threads)


def depth_moves(
    vertices: Array,
    normals: Array,
    maps: Sequence[tuple[View, DepthMap | None, NDArray[np.int64]]],
    weights: Sequence[Floats],
    step: float,
) -> tuple[Array, Array]:
    """Robust mean of the moves (V,) that depth maps ask for, metres, and its weight (V,).

    Args:
        vertices, normals: (V, 3) world.
        maps: photos, their depth maps, and the vertices that they show.
        weights: (h, w) of the pixels of each map.
        step: size of a voxel, metres.
    """
    limits = VertexMoveSettings.current()
    which: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    moves, sure = [np.zeros(0)], [np.zeros(0)]
    for (view, m, index), weight in zip(maps, weights, strict=True):
        if m is None or not len(index) or not len(weight):
            continue
        local = view.T_world_cam.inverse() @ vertices[index]
        uv = np.rint(view.camera.project(local)).astype(np.int64) - [m.x, m.y]
        h, w = m.depth.shape
        within = (uv >= 0).all(axis=1) & (uv < [w, h]).all(axis=1)
        index, local, (x, y) = index[within], local[within], uv[within].T
        pixel = np.stack([x + m.x, y + m.y], axis=1).astype(np.float64)
        there = view.camera.unproject(pixel) * m.depth[y, x, None]
        n = m.normal[y, x].astype(np.float64)
        # Positive: the vertex is before the measured plane.
        off = (n * (local - there)).sum(axis=1)
        cosine = (n * (normals[index] @ view.T_world_cam.R)).sum(axis=1)
        use = (weight[y, x] > 0) & (cosine > limits.facing)
        use &= np.abs(off) < limits.nearest_voxels * step
        which.append(index[use])
        moves.append(-off[use] / np.maximum(cosine[use], 0.5))
        sure.append(weight[y, x][use].astype(np.float64))
    return _robust_mean(
        np.concatenate(which), np.concatenate(moves), np.concatenate(sure), len(vertices),
        limits.spread_voxels * step,
    )  # fmt: skip


def _robust_mean(
    which: NDArray[np.int64], values: Array, weights: Array, count: int, spread: float
) -> tuple[Array, Array]:
    """Mean (count,) of the values (N,) of each index, from their median on, and the weight (count,)
    of those near to it (Geman and McClure)."""
    order = np.lexsort((values, which))
    which, values, weights = which[order], values[order], weights[order]
    total = np.bincount(which, weights, minlength=count)
    before = np.concatenate([[0], np.cumsum(total)])[:-1]
    upper = np.flatnonzero(np.cumsum(weights) - before[which] >= 0.5 * total[which])
    owner, first = np.unique(which[upper], return_index=True)
    mean, near = np.zeros(count), np.zeros(count)
    mean[owner] = values[upper[first]]
    for _ in range(_ROUNDS):
        w = weights / (1 + ((values - mean[which]) / spread) ** 2) ** 2
        near = np.asarray(np.bincount(which, w, minlength=count), np.float64)
        mean = np.bincount(which, w * values, minlength=count) / np.maximum(near, 1e-9)
    return mean, near


def outline_moves(
    vertices: Array,
    faces: NDArray[np.int64],
    normals: Array,
    views: Sequence[View],
    *,
    threads: int = 1,
) -> tuple[Array, Array]:
    """Mean move (V,) of the vertices on the rim of photos to the outlines of the masks, metres, and
    the number of those photos (V,).

    Args:
        vertices: (V, 3) world.
        faces: (F, 3) of a closed mesh.
        normals: (V, 3) of the vertices.
        views: photos with masks.
        threads: number of threads.
    """
    caster = RayCaster(vertices, faces, threads=1)
    found = in_threads(
        lambda view: _of_photo(view, caster, vertices, normals), views, threads=threads
    )
    total = np.sum([move for move, _ in found], axis=0)
    number = np.sum([rim for _, rim in found], axis=0)
    # Spread over the neighbours, so that the rim does not become a ridge.
    average = averaging(faces, len(vertices))
    total, number = average @ total, average @ number
    return total / np.maximum(number, 1e-9), number


def _of_photo(
    view: View, caster: RayCaster, vertices: Array, normals: Array
) -> tuple[Array, Array]:
    """Sum of the wanted moves along the normal (V,), metres, and their weights (V,)."""
    limits = VertexMoveSettings.current()
    whole = (0, 0, view.camera.width, view.camera.height)
    drawn = hull_depth(view, caster, np.zeros(3), whole)[0] > 0
    reach = int(limits.farthest_px) + 3
    rim = outline_distance(drawn, reach) / 32.0
    wanted = outline_distance(view.possible, reach) / 32.0
    uv, z = view.project(vertices)
    uv = np.where(np.isfinite(uv), uv, -10)
    x, y = np.rint(uv.T).astype(np.int64)
    move, weight = np.zeros(len(vertices)), np.zeros(len(vertices))
    index = np.flatnonzero((x >= 1) & (y >= 1) & (x < whole[2] - 1) & (y < whole[3] - 1))
    x, y = x[index], y[index]
    ray = vertices[index] - view.centre
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    across = np.abs((ray * normals[index]).sum(axis=1))
    off = wanted[y, x]
    use = (np.abs(rim[y, x]) < limits.rim_px) & (across < limits.across)
    use &= (np.abs(off) < limits.farthest_px) & _known(view)[y, x]
    kept = index[use]
    # The mesh's own outline is not quite at its vertices.
    move[kept] = (rim[y, x] - off)[use] * z[kept] / view.camera.fx
    weight[kept] = 1.0
    return move, weight


def _known(view: View) -> NDArray[np.bool_]:
    """Pixels where the outline of the mask is that of the object."""
    h, w = view.image.shape[:2]
    known = np.zeros((h, w), bool)
    known[_BESIDE_PX : h - _BESIDE_PX, _BESIDE_PX : w - _BESIDE_PX] = True
    if view.hidden is not None:
        known &= ~dilated(view.hidden, _BESIDE_PX)
    return known


def averaging(faces: NDArray[np.int64], count: int) -> coo_matrix:
    """Sparse matrix that averages values of vertices over their neighbours and themselves."""
    i = np.concatenate([faces[:, 0], faces[:, 1], faces[:, 2], np.arange(count)])
    j = np.concatenate([faces[:, 1], faces[:, 2], faces[:, 0], np.arange(count)])
    both = coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count)).tocsr()
    both = ((both + both.T) > 0).astype(np.float64)
    return diags(1 / np.asarray(both.sum(axis=1)).ravel()) @ both
