"""Visible contours of objects, to a small fraction of a pixel.

Three kinds are traced: the silhouette, where the object ends before the background or an object
behind it; the contours inside it, where one part of the object hides another (the near rim of a
bowl, the handle of a mug); and its sharp creases. Leaving the latter two out would not only lose
evidence: their edges are strong, and the silhouette would be drawn to them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.caster import Patch, WorldCaster

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Flags = NDArray[np.bool_]

# The boundary is searched this far outside the outermost pixel of the surface.
_REACH_PX = 2.0
_BISECTIONS = 6
# A step in depth inside an object is a contour from here on: metres, and pixel footprints.
_SMALLEST_JUMP_M = 0.005
_SMALLEST_JUMP_FOOTPRINTS = 4.0
# Faces that meet at a larger angle make an edge in the image.
_CREASE_COSINE = float(np.cos(np.deg2rad(40)))
# Half width of the window in which the direction of a contour is found.
_WINDOW = 4


class Kind(IntEnum):
    """What makes a contour."""

    SILHOUETTE = 0
    INNER = 1
    CREASE = 2


@dataclass(frozen=True, eq=False)
class Contour:
    """Samples of one object's visible contours in one image.

    Attributes:
        pixels: (N, 2) on the boundary.
        normals: (N, 2) unit, from the object outward (from the near part to the far one).
        points: (N, 3) rim points on the object, world frame.
        kind: (N,) `Kind`.
        thinning: contour pixels per sample.
    """

    pixels: Array
    normals: Array
    points: Array
    kind: NDArray[np.int8]
    thinning: float

    @cached_property
    def neighbours(self) -> Array:
        """(N, N) squared pixel distances, inf between samples that face different ways."""
        p, n = self.pixels, self.normals
        square = (p**2).sum(axis=1)
        distance = np.maximum(square[:, None] + square[None] - 2 * p @ p.T, 0)
        same = (n @ n.T > 0.7) & (self.kind[:, None] == self.kind[None])
        return np.where(same, distance, np.inf)


@dataclass(frozen=True, eq=False)
class _Sides:
    """Contour pixels and the pixel on the other side of the contour, rows and columns."""

    v: NDArray[np.intp]
    u: NDArray[np.intp]
    other_v: NDArray[np.intp]
    other_u: NDArray[np.intp]
    kind: NDArray[np.int8]


def trace_contour(
    caster: WorldCaster,
    patch: Patch,
    index: int,
    camera: Camera,
    T_world_cam: SE3,
    *,
    limit: int = 320,
) -> Contour | None:
    """Contours of object `index` in its patch, at most `limit` samples; None if it is hidden."""
    mask = patch.hits.object == index
    if mask.sum() < 30:
        return None
    depth = np.where(patch.hits.object >= 0, patch.hits.depth, np.float32(1e3))
    footprint = float(np.median(depth[mask])) / camera.fx
    sides = _find(mask, depth, patch.hits.normal, footprint)
    if len(sides.v) < 8:
        return None
    thinning = max(1.0, len(sides.v) / limit)
    keep = np.unique(np.linspace(0, len(sides.v) - 1, min(limit, len(sides.v))).round().astype(int))
    sides = _Sides(*(getattr(sides, f)[keep] for f in ("v", "u", "other_v", "other_u", "kind")))
    near = depth[sides.v, sides.u].astype(np.float64)
    # Halfway between the near surface and the far one.
    far = np.minimum(depth[sides.other_v, sides.other_u], near + 10.0)
    border = (near + far) / 2
    n_here = patch.hits.normal[sides.v, sides.u]
    n_there = patch.hits.normal[sides.other_v, sides.other_u]

    def on_near_side(
        is_object: NDArray[np.bool_], d: NDArray[np.float32], normal: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        shape = (-1,) + (1,) * (is_object.ndim - 1)
        inner = d < border.reshape(shape)
        axes = (n_here - n_there).reshape(*shape, 3)
        crease = (normal * axes).sum(axis=-1) > 0
        kind = sides.kind.reshape(shape)
        return is_object & ((kind != Kind.INNER) | inner) & ((kind != Kind.CREASE) | crease)

    normals, clear = _normals(mask, depth, patch.hits.normal, sides, on_near_side)
    start = np.stack([sides.u + patch.x, sides.v + patch.y], axis=1).astype(np.float64)

    def inside(offset: Array) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        hits = caster.cast(camera, T_world_cam, start + offset[:, None] * normals)
        return on_near_side(hits.object == index, hits.depth, hits.normal), hits.depth

    low, high = np.zeros(len(start)), np.full(len(start), _REACH_PX)
    out, out_depth = inside(high)
    valid = clear & ~out & ((out_depth > near) | (sides.kind == Kind.CREASE))
    beyond = start + _REACH_PX * normals
    valid &= ((beyond >= 1) & (beyond <= np.array(camera.size) - 2)).all(axis=1)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        is_in, d = inside(middle)
        low, high = np.where(is_in, middle, low), np.where(is_in, high, middle)
        near = np.where(is_in, d, near)
    pixels = start + ((low + high) / 2)[:, None] * normals
    if valid.sum() < 8:
        return None
    points = T_world_cam @ camera.unproject(pixels[valid], near[valid])
    return Contour(pixels[valid], normals[valid], points, sides.kind[valid], thinning)


def contour_image(patch: Patch) -> NDArray[np.float32]:
    """(h, w) 1 on every predicted contour of any object, 0 elsewhere."""
    depth = np.where(patch.hits.object >= 0, patch.hits.depth, np.float32(1e3))
    ids = patch.hits.object
    edge = np.zeros(ids.shape, np.float32)
    for axis in (0, 1):
        a = np.moveaxis(edge, axis, 0)
        i, d = np.moveaxis(ids, axis, 0), np.moveaxis(depth, axis, 0)
        n = np.moveaxis(patch.hits.normal, axis, 0)
        changed = (i[1:] != i[:-1]) | (np.abs(d[1:] - d[:-1]) > 0.012)
        changed |= (i[1:] >= 0) & ((n[1:] * n[:-1]).sum(axis=-1) < _CREASE_COSINE)
        a[1:][changed] = 1
        a[:-1][changed] = 1
    return edge


def _find(
    mask: NDArray[np.bool_],
    depth: NDArray[np.float32],
    normal: NDArray[np.float32],
    footprint: float,
) -> _Sides:
    """Pixels of the object with a contour to one of their four neighbours, the largest step."""
    threshold = max(_SMALLEST_JUMP_M, _SMALLEST_JUMP_FOOTPRINTS * footprint)
    best = np.zeros(mask.shape, np.float32)
    kinds = np.full(mask.shape, -1, np.int8)
    toward = np.zeros((*mask.shape, 2), np.int8)

    def note(axis: int, direction: int, kind: Kind, where: Flags, step: Array32) -> None:
        b, k, t = (np.moveaxis(x, axis, 0)[::direction][1:-1] for x in (best, kinds, toward))
        better = where & (step > b)
        b[better], k[better] = step[better], kind
        t[better] = (direction, 0) if axis == 0 else (0, direction)

    for kind in Kind:
        if kind != Kind.SILHOUETTE:
            # Next to the silhouette surfaces turn away: what looks like a step there is none.
            outer = (kinds == Kind.SILHOUETTE).astype(np.uint8)
            near_outer = cv2.dilate(outer, np.ones((5, 5), np.uint8)) > 0
        for axis, direction in ((0, 1), (0, -1), (1, 1), (1, -1)):
            m: Flags = np.moveaxis(mask, axis, 0)[::direction]
            d: Array32 = np.moveaxis(depth, axis, 0)[::direction]
            n: Array32 = np.moveaxis(normal, axis, 0)[::direction]
            step = d[2:] - d[1:-1]
            if kind == Kind.SILHOUETTE:
                note(axis, direction, kind, m[1:-1] & ~m[2:] & (step > 0), step)
                continue
            free = ~np.moveaxis(near_outer, axis, 0)[::direction][1:-1]
            # What a slanted surface would do anyway is no step.
            slope = np.maximum(np.where(m[:-2], d[1:-1] - d[:-2], 0), 0)
            hides = step - slope > threshold
            same = m[1:-1] & m[2:] & m[:-2] & free
            if kind == Kind.INNER:
                note(axis, direction, kind, same & hides, step)
            elif direction == 1:
                turn = (n[2:] * n[1:-1]).sum(axis=-1) < _CREASE_COSINE
                flat = np.abs(step) < threshold
                note(
                    axis, direction, kind, same & turn & flat, np.full(step.shape, 1e-6, np.float32)
                )
    v, u = np.nonzero(kinds >= 0)
    return _Sides(v, u, v + toward[v, u, 0], u + toward[v, u, 1], kinds[v, u])


def _normals(
    mask: NDArray[np.bool_],
    depth: NDArray[np.float32],
    normal: NDArray[np.float32],
    sides: _Sides,
    on_near_side: Callable[..., NDArray[np.bool_]],
) -> tuple[Array, NDArray[np.bool_]]:
    """Outward unit normals (N, 2), and which are clear: from the near side's centre of mass."""
    w = _WINDOW
    grid = np.meshgrid(np.arange(-w, w + 1), np.arange(-w, w + 1))
    offsets = np.stack(grid, axis=-1).reshape(-1, 2)
    bell = np.exp(-0.5 * (offsets**2).sum(axis=1) / 2.0**2)
    around = [(w, w), (w, w)]
    rows = sides.v[:, None] + w + offsets[None, :, 1]
    columns = sides.u[:, None] + w + offsets[None, :, 0]
    near = on_near_side(
        np.pad(mask, around)[rows, columns],
        np.pad(depth, around, constant_values=1e3)[rows, columns],
        np.pad(normal, [*around, (0, 0)])[rows, columns],
    )
    moment = (near * bell) @ offsets
    length = np.linalg.norm(moment, axis=1)
    normals = -moment / np.maximum(length, 1e-9)[:, None]
    return normals, length > 0.15 * bell.sum()
