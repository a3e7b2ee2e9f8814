"""The side that no photo shows: flattened, as the side that an object stands on is.

Below the lowest photos, the visual hull goes on as a cone. Where the rim of an unseen part is
plane, the part is a face of the object that nobody saw, and is closed by that plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from std_toolkit.arrays import Array, Mask
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.photos.views import View
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class UndersideSettings(Settings):
    """Which unseen parts are flattened."""

    smallest: float = limit(0.03, source=NOT_RECORDED)
    """smallest unseen part, as a share of the surface"""
    plane: float = limit(0.012, source=NOT_RECORDED)
    """largest deviation of its rim from a plane, as a share of the longest side"""
    rim: float = limit(0.35, source="hidden hollows above it may have rims, too")
    """share of the rim that must be in the plane"""
    grazing: float = limit(0.25, source=NOT_RECORDED)
    """sine of the angle below which a face counts as not seen"""


def seen_faces(vertices: Array, faces: NDArray[np.int64], views: Sequence[View]) -> Mask:
    """(F,) whether any photo shows the middle of a face."""
    limits = UndersideSettings.current()
    corners = vertices[faces]
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-20
    caster = RayCaster(vertices, faces)
    seen = np.zeros(len(faces), bool)
    for view in views:
        ray = middle - view.centre
        away = np.linalg.norm(ray, axis=1)
        ray /= away[:, None]
        index = np.flatnonzero(~seen & (-(ray * normal).sum(axis=1) > limits.grazing))
        if len(index) == 0:
            continue
        rays = np.concatenate([np.broadcast_to(view.centre, (len(index), 3)), ray[index]], axis=1)
        free = caster.cast(rays).distance > away[index] * 0.998 - 0.0005
        seen[index[free]] = True
    return seen


def flatten_unseen(
    vertices: Array, faces: NDArray[np.int64], views: Sequence[View]
) -> tuple[Array, float]:
    """Move the largest unseen part back to the plane of its rim.

    Args:
        vertices: (V, 3) world.
        faces: (F, 3) of a closed mesh.
        views: photos.

    Returns:
        Moved vertices, and the share of the surface that was flattened, 0 for none.
    """
    limits = UndersideSettings.current()
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    part = _largest_part(faces, ~seen_faces(vertices, faces, views), area)
    share = float(area[part].sum() / area.sum())
    if share < limits.smallest:
        return vertices, 0.0
    inner = np.unique(faces[part])
    rim = np.intersect1d(inner, np.unique(faces[~part]))
    if len(rim) < 12:
        return vertices, 0.0
    points = vertices[rim]
    longest = float(np.ptp(vertices, axis=0).max())
    middle, normal, inliers = _rim_plane(points, limits.plane * longest)
    if inliers < limits.rim:
        return vertices, 0.0
    if normal @ cross[part].sum(axis=0) < 0:
        normal = -normal
    # Voxels round the edge off: the outermost of the rim is nearest to it.
    off = (points - middle) @ normal
    middle = middle + np.percentile(off[np.abs(off) < limits.plane * longest], 90) * normal
    height = (vertices - middle) @ normal
    below = (height[faces] > 0).all(axis=1)
    # All of the object is on one side of the plane that it stands on.
    if area[below & ~part].sum() > 0.01 * area.sum():
        return vertices, 0.0
    moved = vertices - np.maximum(height, 0)[:, None] * normal
    return moved, float(area[below].sum() / area.sum())


def _rim_plane(points: Array, tolerance: float) -> tuple[Array, Array, float]:
    """Point and normal of the plane through most of a rim, and the share of the rim in it."""
    rng = np.random.default_rng(0)
    best = np.zeros(len(points), bool)
    for _ in range(400):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        size = np.linalg.norm(normal)
        if size < 1e-9:
            continue
        inside = np.abs((points - a) @ normal) < tolerance * size
        if inside.sum() > best.sum():
            best = inside
    middle = points[best].mean(axis=0)
    normal = np.linalg.svd(points[best] - middle, full_matrices=False)[2][-1]
    return middle, normal, float(best.mean())


def _largest_part(faces: NDArray[np.int64], chosen: Mask, area: Array) -> Mask:
    """The chosen faces that are connected by vertices and have the largest area."""
    result = np.zeros(len(faces), bool)
    index = np.flatnonzero(chosen)
    if len(index) == 0:
        return result
    f = faces[index]
    count = int(faces.max()) + 1
    i, j = np.concatenate([f[:, 0], f[:, 1]]), np.concatenate([f[:, 1], f[:, 2]])
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    total = np.bincount(label[f[:, 0]], area[index])
    result[index] = label[f[:, 0]] == total.argmax()
    return result
