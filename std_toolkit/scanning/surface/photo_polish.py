"""Polish of a mesh: vertices move along their normals to where photos agree best.

At each of a few displacements, a patch of the tangent plane is projected to the photos that see it
from the front. Its place is where the patches correlate best (normalised cross-correlation, as in
Furukawa and Ponce, PAMI 2010), if this place is distinct.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.compiled import compiled
from std_toolkit.geometry import SE3
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.photos.visibility import depth_of, seen_from, vertex_normals
from std_toolkit.scanning.surface.polish import above_floors
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Displacements to either side of a vertex.
_STEPS = 4
# Points along a side of a patch, one pixel apart in the nearest photo.
_SIDE = 9
_PHOTOS = 5
# Drop of the correlation towards the ends of the search from which it counts fully.
_CLEAR_DROP = 0.1
# Standard deviation of grey values, below which a patch is plain.
_LEAST_CONTRAST = 3.0


@dataclass(frozen=True, kw_only=True)
class PhotoPolishSettings(Settings):
    """When photos agree on the place of a vertex."""

    least_apart: float = limit(0.99, source="at least 8 degrees")
    """largest cosine of the angle between the rays of two photos"""
    correlation: float = limit(0.6, source=NOT_RECORDED)
    """smallest mean correlation of pairs of photos"""
    drop: float = limit(0.02, source=NOT_RECORDED)
    """smallest drop of the correlation towards the ends of the search"""


def fit_photos(
    vertices: Array,
    faces: NDArray[np.int64],
    views: Sequence[View],
    *,
    reach: float,
    average: Any,
    floors: Sequence[SE3] = (),
    rounds: int = 2,
) -> tuple[Array, float]:
    """Vertices (V, 3) moved to where photos agree, and the share of them that
    had such a place in one of the rounds.

    Args:
        vertices: (V, 3) world.
        faces: (F, 3) of a closed mesh.
        views: photos with masks.
        reach: how far a vertex is searched to either side of its place, metres; half as far in
            each next round.
        average: of `averaging`.
        floors: motions whose z = 0 is a table, below which no vertex is moved.
        rounds: number of repetitions.
    """
    images = np.stack([v.grey() for v in views])
    P = np.stack([v.P for v in views])
    share = 0.0
    for n in range(rounds):
        normals = vertex_normals(vertices, faces)
        chosen, pixel = _best_photos(vertices, faces, normals, views)
        steps = reach / 2**n * np.linspace(-1, 1, 2 * _STEPS + 1)
        scores = np.zeros((len(vertices), len(steps)))
        _correlate(images, P, vertices, normals, chosen, pixel, steps, scores)
        move, weight = _best(scores, steps)
        share = max(share, float((weight > 0).mean()))
        for _ in range(2):
            move, weight = average @ (move * weight), average @ weight
            move = move / np.maximum(weight, 1e-9)
        # Where no neighbour was measured nothing moves.
        move = move * np.minimum(weight / 0.1, 1)
        vertices = above_floors(vertices + move[:, None] * normals, floors)
    return vertices, share


def _best_photos(
    vertices: Array, faces: NDArray[np.int64], normals: Array, views: Sequence[View]
) -> tuple[NDArray[np.int64], Array]:
    """Up to 5 photos (V, 5) that see each vertex best, the best first, -1 for none; and the size
    of a pixel of the first at the vertex (V,), metres."""
    limits = PhotoPolishSettings.current()
    caster = RayCaster(vertices, faces)
    weight = np.stack([seen_from(v, vertices, normals, depth_of(v, caster))[1] for v in views])
    rays = np.stack([vertices - v.centre for v in views])
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    sizes = np.stack([v.project(vertices)[1] / v.camera.fx for v in views])
    rows = np.arange(len(vertices))
    chosen = np.full((len(vertices), _PHOTOS), -1)
    for k in range(_PHOTOS):
        best = weight.argmax(axis=0)
        chosen[:, k] = np.where(weight[best, rows] > 0, best, -1)
        # Photos from nearly the same place agree on any depth.
        weight[(rays * rays[best, rows]).sum(axis=2) > limits.least_apart] = 0
    return chosen, np.where(chosen[:, 0] >= 0, sizes[chosen[:, 0], rows], 0.0)


def _best(scores: Array, steps: Array) -> tuple[Array, Array]:
    """The displacement of the best correlation (V,), and its weight, 0 where it is not distinct."""
    limits = PhotoPolishSettings.current()
    best = scores.argmax(axis=1)
    rows = np.arange(len(scores))
    inner = np.clip(best, 1, len(steps) - 2)
    below, peak, above = (scores[rows, inner + k] for k in (-1, 0, 1))
    curve = below - 2 * peak + above
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curve < 0, 0.5 * (below - above) / curve, 0.0)
    move = steps[inner] + np.clip(shift, -0.5, 0.5) * (steps[1] - steps[0])
    drop = peak - np.maximum(scores[:, 0], scores[:, -1])
    good = (best == inner) & (peak > limits.correlation) & (drop > limits.drop)
    weight = peak * np.minimum(drop / _CLEAR_DROP, 1)
    return np.where(good, move, 0.0), np.where(good, weight, 0.0)


@compiled
def _correlate(images, P, vertices, normals, chosen, pixel, steps, scores) -> None:  # type: ignore[no-untyped-def]
    h, w = images.shape[1:]
    points = _SIDE * _SIDE
    patch = np.zeros(points)
    for v in range(vertices.shape[0]):
        photos = 0
        while photos < chosen.shape[1] and chosen[v, photos] >= 0:
            photos += 1
        if photos < 3:
            continue
        n = normals[v]
        # Any two directions across the normal.
        axis = np.zeros(3)
        axis[np.argmin(np.abs(n))] = 1.0
        a = np.cross(n, axis)
        a /= np.sqrt((a * a).sum())
        b = np.cross(n, a)
        for s in range(steps.shape[0]):
            total = np.zeros(points)
            used = 0
            for k in range(photos):
                T = P[chosen[v, k]]
                image = images[chosen[v, k]]
                mean = 0.0
                inside = True
                for p in range(points):
                    i = (p // _SIDE - _SIDE // 2) * pixel[v]
                    j = (p % _SIDE - _SIDE // 2) * pixel[v]
                    x = vertices[v, 0] + steps[s] * n[0] + i * a[0] + j * b[0]
                    y = vertices[v, 1] + steps[s] * n[1] + i * a[1] + j * b[1]
                    z = vertices[v, 2] + steps[s] * n[2] + i * a[2] + j * b[2]
                    depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
                    px = (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth
                    py = (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth
                    if not (px >= 0 and py >= 0 and px < w - 1.001 and py < h - 1.001):
                        inside = False
                        break
                    ix, iy = int(px), int(py)
                    fx, fy = px - ix, py - iy
                    patch[p] = (1 - fy) * (
                        (1 - fx) * image[iy, ix] + fx * image[iy, ix + 1]
                    ) + fy * ((1 - fx) * image[iy + 1, ix] + fx * image[iy + 1, ix + 1])
                    mean += patch[p]
                if not inside:
                    continue
                mean /= points
                square = 0.0
                for p in range(points):
                    patch[p] -= mean
                    square += patch[p] * patch[p]
                if square < points * _LEAST_CONTRAST**2:
                    continue
                length = np.sqrt(square)
                for p in range(points):
                    total[p] += patch[p] / length
                used += 1
            if used >= 3:
                # The squared sum of unit vectors holds every pair twice, and each with itself.
                scores[v, s] = ((total * total).sum() - used) / (used * (used - 1))
