"""Closed surface from depth maps: agreement between photos, fusion on voxels, decimation.

Where no depth map supports the surface, it is that of the visual hull.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.compiled import compiled
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import import_open3d
from std_toolkit.log import logger
from std_toolkit.scanning.masks.hull import largest_component, surface_of
from std_toolkit.scanning.photos.views import Grid, View, in_threads
from std_toolkit.scanning.surface.depth_maps import DepthMap, choose_neighbours
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Weight of the hull against one depth measurement of weight 1.
_HULL_WEIGHT = 0.15
# Standard deviations, in voxels, by which the field is smoothed: where it is measured, and else.
_SMOOTHED = (0.8, 2.0)


@dataclass(frozen=True, kw_only=True)
class AgreementSettings(Settings):
    """Depths of the photos that agree."""

    largest_cost: float = limit(0.45, source="larger ones are chance")
    """largest cost (1 - correlation)"""
    agreement: float = limit(0.003, source="the real bottle: 0.6 mm at 0.6 m, five times")
    """two depth maps agree within this fraction of the depth"""
    before: float = limit(0.015, source="thinner than what hides another part of an object")
    """a surface that is nearer by less than this fraction of the depth contradicts"""
    doubtful: float = limit(0.25, source="plain, glossy sides of the real bottle")
    """share of the photos that must agree, of those that agree or contradict"""
    certain: float = limit(0.6, source="as above")
    """share from which a depth counts fully"""
    supported: float = limit(2.0, source=NOT_RECORDED)
    """weight of depth measurements from which they outvote the outlines of few photos"""


@dataclass(frozen=True, eq=False)
class Fusion:
    """Fused field.

    Attributes:
        field: signed distance on the grid, metres, negative inside.
        support: weight of the depth measurements of each voxel.
    """

    field: Floats
    support: Floats


def agreeing(
    views: Sequence[View],
    layers: Sequence[Sequence[DepthMap | None]],
    target: Array,
    *,
    threads: int = 1,
) -> list[Floats]:
    """Weight (h, w) of every pixel of the depth maps, layer by layer; 0 where no two others agree,
    or many contradict.

    Args:
        views: photos.
        layers: their depth maps, one for each photo in each of the layers: by matching, by a
            sensor. A photo agrees if its map in any layer does.
        target: (3,) centre of the object.
        threads: number of threads.
    """
    limits = AgreementSettings.current()
    chosen = choose_neighbours(views, target, 12)

    def one(place: tuple[int, int]) -> Floats:
        layer, i = place
        m = layers[layer][i]
        if m is None:
            return np.zeros((0, 0), np.float32)
        view = views[i]
        h, w = m.depth.shape
        v, u = np.nonzero((m.depth > 0) & (m.cost < limits.largest_cost))
        d = m.depth[v, u].astype(np.float64)
        uv = np.stack([u + m.x, v + m.y], axis=1).astype(np.float64)
        points = view.T_world_cam @ view.camera.unproject(uv, d)
        votes, against = np.zeros(len(d)), np.zeros(len(d))
        for j in chosen[i]:
            others = [maps[j] for maps in layers]
            if all(other is None for other in others):
                continue
            p, z = views[j].project(points)
            p = np.where(np.isfinite(p), p, -1e6)
            said = [_agree(other, p, z) for other in others if other is not None]
            agreed = np.any(np.stack([yes for yes, _ in said]), axis=0)
            votes += agreed
            against += np.any(np.stack([no for _, no in said]), axis=0) & ~agreed
        rays = view.camera.unproject(uv)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        facing = np.abs((m.normal[v, u] * rays).sum(axis=1))
        certain = np.clip(1 - m.cost[v, u] / limits.largest_cost, 0, 1) * np.clip(
            m.contrast[v, u] / 3.0, 0, 1
        )
        # Where highlights move with the photos, each has its own depth.
        share = votes / np.maximum(votes + against, 1)
        trust = np.clip((share - limits.doubtful) / (limits.certain - limits.doubtful), 0, 1)
        found = np.minimum(votes, 5) / 5 * (0.1 + certain) * facing * trust
        weight = np.zeros((h, w), np.float32)
        weight[v, u] = np.where(votes >= 2, found, 0)
        return weight

    places = [(layer, i) for layer in range(len(layers)) for i in range(len(views))]
    return in_threads(one, places, threads=threads)


def _agree(m: DepthMap, p: Array, z: Array) -> tuple[Mask, Mask]:
    """Which points (N,), at pixels p (N, 2) and depths z of a photo, its map confirms, and which it
    contradicts: it sees through them, or a surface just before them."""
    limits = AgreementSettings.current()
    x = np.rint(p[:, 0]).astype(np.int64) - m.x
    y = np.rint(p[:, 1]).astype(np.int64) - m.y
    inside = (x >= 0) & (y >= 0) & (x < m.depth.shape[1]) & (y < m.depth.shape[0])
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    there = m.depth[y, x].astype(np.float64)
    inside &= there > 0
    off = there - z
    agreed = inside & (m.cost[y, x] < limits.largest_cost) & (np.abs(off) < limits.agreement * z)
    against = inside & (np.abs(off) >= limits.agreement * z) & (off > -limits.before * z)
    return np.asarray(agreed), np.asarray(against)


def fuse(
    views: Sequence[View],
    maps: Sequence[DepthMap | None],
    weights: Sequence[Floats],
    hull: Floats,
    disputed: Floats,
    grid: Grid,
    *,
    threads: int = 1,
) -> Fusion:
    """Fuse depth maps and visual hull to one signed distance field.

    Args:
        views: photos.
        maps: their depth maps.
        weights: of `agreeing`.
        hull: of `hull_field`; it bounds the surface where depth maps do not support it.
        disputed: the same of a hull that contains it, which bounds the supported surface.
        grid: the voxels.
        threads: number of threads.
    """
    from scipy.ndimage import gaussian_filter

    kept = [i for i, m in enumerate(maps) if m is not None and (weights[i] > 0).any()]
    band = 4 * grid.step
    total = np.zeros(grid.shape, np.float32)
    support = np.zeros(grid.shape, np.float32)
    if kept:
        h = max(weights[i].shape[0] for i in kept)
        w = max(weights[i].shape[1] for i in kept)
        depth = np.zeros((len(kept), h, w), np.float32)
        normal = np.zeros((len(kept), h, w, 3), np.float32)
        weight = np.zeros((len(kept), h, w), np.float32)
        corner = np.zeros((len(kept), 2), np.int64)
        for n, i in enumerate(kept):
            m = maps[i]
            assert m is not None
            a, b = m.depth.shape
            depth[n, :a, :b], normal[n, :a, :b], weight[n, :a, :b] = m.depth, m.normal, weights[i]
            corner[n] = m.x, m.y
        T = np.stack([views[i].T_world_cam.inverse().matrix()[:3] for i in kept])
        K = np.stack([views[i].camera.K for i in kept])
        parts = np.array_split(np.arange(grid.shape[0]), min(grid.shape[0], 4 * threads))
        in_threads(
            lambda part: _integrate(
                T, K, corner, depth, normal, weight, disputed, np.array(grid.origin), grid.step,
                band, int(part[0]), int(part[-1]) + 1, total, support,
            ),
            parts,
            threads=threads,
        )  # fmt: skip
    prior = np.clip(hull, -band, band)
    # Smoothed with its weight: noise of single maps goes, edges of two voxels stay. What few maps
    # measure is noisier, and smoothed more.
    for_total, wide_total = (gaussian_filter(total + _HULL_WEIGHT * prior, s) for s in _SMOOTHED)
    for_weight, wide_weight = (
        gaussian_filter(support + np.float32(_HULL_WEIGHT), s) for s in _SMOOTHED
    )
    trust = np.clip((for_weight - _HULL_WEIGHT) / AgreementSettings.current().supported, 0, 1)
    bound = (1 - trust) * prior + trust * np.clip(disputed, -band, band)
    measured = trust * for_total / for_weight + (1 - trust) * wide_total / wide_weight
    field = np.maximum(measured, bound)
    return Fusion(field.astype(np.float32), support)


@compiled
def _integrate(  # type: ignore[no-untyped-def]
    T, K, corner, depth, normal, weight, hull, origin, step, band, z0, z1, total, support
) -> None:
    views, h, w = depth.shape
    for k in range(z0, z1):
        z = origin[2] + k * step
        for j in range(total.shape[1]):
            y = origin[1] + j * step
            for i in range(total.shape[2]):
                if hull[k, j, i] > band:
                    continue
                x = origin[0] + i * step
                a = 0.0
                b = 0.0
                for v in range(views):
                    t = T[v]
                    cz = t[2, 0] * x + t[2, 1] * y + t[2, 2] * z + t[2, 3]
                    if cz <= 1e-6:
                        continue
                    cx = t[0, 0] * x + t[0, 1] * y + t[0, 2] * z + t[0, 3]
                    cy = t[1, 0] * x + t[1, 1] * y + t[1, 2] * z + t[1, 3]
                    px = K[v, 0, 0] * cx / cz + K[v, 0, 2] - corner[v, 0]
                    py = K[v, 1, 1] * cy / cz + K[v, 1, 2] - corner[v, 1]
                    ix, iy = int(np.floor(px + 0.5)), int(np.floor(py + 0.5))
                    if ix < 0 or iy < 0 or ix >= w or iy >= h:
                        continue
                    g = weight[v, iy, ix]
                    if g <= 0:
                        continue
                    d = depth[v, iy, ix]
                    n = normal[v, iy, ix]
                    along = d - cz
                    if along > 3 * band:
                        # Seen through: outside, though a single wrong map must not dig a hole.
                        a += 0.3 * g * band
                        b += 0.3 * g
                        continue
                    ux = (ix + corner[v, 0] - K[v, 0, 2]) / K[v, 0, 0]
                    uy = (iy + corner[v, 1] - K[v, 1, 2]) / K[v, 1, 1]
                    s = n[0] * (cx - ux * d) + n[1] * (cy - uy * d) + n[2] * (cz - d)
                    if s < -band:
                        continue
                    s = min(s, band)
                    a += g * s
                    b += g
                total[k, j, i] = a
                support[k, j, i] = b


def closed_mesh(field: Floats, grid: Grid, faces: int) -> tuple[Array, NDArray[np.int64]]:
    """Watertight mesh of the largest part of a field, with about `faces` faces.

    Raises:
        ToolkitError: the field has no inside.
    """
    kept = np.where(largest_component(field < 0) | (field >= 0), field, np.float32(grid.step))
    vertices, triangles = surface_of(kept, grid)
    if len(triangles) == 0:
        raise ToolkitError(
            "the photos leave no space that the object could fill",
            hint="check the masks in the report, or give your own with --masks",
        )
    vertices, triangles = without_inner_parts(vertices, triangles)
    return decimated(vertices, triangles, faces)


def without_inner_parts(
    vertices: Array, faces: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """The component with the largest volume: closed cavities inside are artefacts."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = np.concatenate([faces[:, 0], faces[:, 1]]), np.concatenate([faces[:, 1], faces[:, 2]])
    graph = coo_matrix((np.ones(len(ends[0]), np.int8), ends), shape=(len(vertices),) * 2)
    count, label = connected_components(graph, directed=False)
    corner = vertices[faces]
    volume = np.einsum("ni,ni->n", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))
    total = np.bincount(label[faces[:, 0]], volume, minlength=count)
    # Cavities have a negative volume.
    kept = label == total.argmax()
    number = np.cumsum(kept) - 1
    return vertices[kept], number[faces[kept[faces[:, 0]]]]


def decimated(
    vertices: Array, faces: NDArray[np.int64], count: int
) -> tuple[Array, NDArray[np.int64]]:
    """A closed mesh of about `count` faces; by manifold3d if quadric decimation tears it."""
    o3d = import_open3d()

    fine = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    fine = fine.filter_smooth_taubin(3)
    small = fine
    if len(faces) > count:
        small = fine.simplify_quadric_decimation(count)
        small.remove_degenerate_triangles()
        small.remove_unreferenced_vertices()
    found = np.asarray(small.vertices), np.asarray(small.triangles).astype(np.int64)
    if is_closed(*found):
        return found
    logger.info("decimation tore the surface; simplified by manifold3d instead")
    return _simplified(np.asarray(fine.vertices), np.asarray(fine.triangles), count)


def is_closed(vertices: Array, faces: NDArray[np.int64]) -> bool:
    """Whether a mesh is an oriented 2-manifold without borders."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    )
    return solid.status() == manifold3d.Error.NoError and solid.volume() > 0


def _simplified(
    vertices: Array, faces: NDArray[np.integer], count: int
) -> tuple[Array, NDArray[np.int64]]:
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    )
    if solid.status() != manifold3d.Error.NoError:
        raise ToolkitError(f"the surface cannot be closed: {solid.status()}")
    low, high = 1e-6, 0.01 * float(np.ptp(vertices, axis=0).max())
    for _ in range(14):
        middle = float(np.sqrt(low * high))
        if solid.simplify(middle).num_tri() > count:
            low = middle
        else:
            high = middle
    mesh = solid.simplify(high).to_mesh()
    return np.asarray(mesh.vert_properties[:, :3], np.float64), np.asarray(mesh.tri_verts, np.int64)
