"""Visible contours of objects, to a small fraction of a pixel.

Three kinds are traced: the silhouette, where the object ends in front of the background or another
object; inner contours, where one part of the object occludes another (the near rim of a bowl, the
handle of a mug); and sharp creases. Inner contours and creases are needed because their edges are
strong and would attract the silhouette.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine.caster import Patch, WorldCaster

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Flags = NDArray[np.bool_]

# The boundary is searched this far outside the outermost pixel of the surface.
_REACH_PX = 2.0
# Number of rays along each normal, and of rounds, that enclose it to 1/64 of the reach.
_RAYS, _ROUNDS = 4, 3
# Smallest depth step inside an object that is a contour: metres, and pixel footprints.
_SMALLEST_JUMP_M = 0.005
_SMALLEST_JUMP_FOOTPRINTS = 4.0
# Faces that meet at a larger angle make an edge in the image.
_CREASE_COSINE = float(np.cos(np.deg2rad(40)))
# Samples whose normals have at least this cosine face the same direction.
_SAME_WAY = 0.7
# Half width of the window in which the direction of a contour is found.
_WINDOW = 4
_AROUND = np.stack(np.meshgrid(*[np.arange(-_WINDOW, _WINDOW + 1)] * 2), axis=-1).reshape(-1, 2)
_BELL = np.exp(-0.5 * (_AROUND**2).sum(axis=1) / 2.0**2)


class Kind(IntEnum):
    """Kind of a contour."""

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

    def near(self, reach: float) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """Pairs of samples within `reach` pixels that face about the same way, in both orders.

        Returns:
            Indices (M,) and (M,) of the samples, including pairs of a sample with itself, and
            their squared distances (M,) in pixels.
        """
        from scipy.spatial import cKDTree

        a, b = cKDTree(self.pixels).query_pairs(reach, output_type="ndarray").T
        # Columns and rows apart: small last axes are slow.
        (nx, ny), (x, y) = self.normals.T.copy(), self.pixels.T.copy()
        same = (nx[a] * nx[b] + ny[a] * ny[b] > _SAME_WAY) & (self.kind[a] == self.kind[b])
        a, b = a[same], b[same]
        square = (x[a] - x[b]) ** 2 + (y[a] - y[b]) ** 2
        self_ = np.arange(len(nx))
        return (
            np.concatenate([a, b, self_]),
            np.concatenate([b, a, self_]),
            np.concatenate([square, square, np.zeros(len(nx))]),
        )


@dataclass(frozen=True, eq=False)
class _Sides:
    """Contour pixels and the pixel on the other side of the contour, rows and columns."""

    v: NDArray[np.intp]
    u: NDArray[np.intp]
    other_v: NDArray[np.intp]
    other_u: NDArray[np.intp]
    kind: NDArray[np.int8]

    def only(self, chosen: NDArray[Any]) -> _Sides:
        """Some of the pixels, by flags or indices."""
        each = self.v, self.u, self.other_v, self.other_u, self.kind
        return _Sides(*(a[chosen] for a in each))


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
    sides = sides.only(keep)
    border = _Border.of(depth, patch.hits.normal, sides)
    normals, clear = _normals(mask, depth, patch.hits.normal, sides, border)
    start = np.stack([sides.u + patch.x, sides.v + patch.y], axis=1).astype(np.float64)
    beyond = start + _REACH_PX * normals
    valid = clear & ((beyond >= 1) & (beyond <= np.array(camera.size) - 2)).all(axis=1)
    start, normals = start[valid], normals[valid]
    sides, border = sides.only(valid), border.only(valid)
    near = depth[sides.v, sides.u].astype(np.float64)
    low, high = np.zeros(len(start)), np.full(len(start), _REACH_PX)
    share = np.arange(1, _RAYS + 1) / _RAYS
    for round_ in range(_ROUNDS):
        rows = np.arange(len(start))
        # The end of the range is known to be outside from the first round.
        along = low[:, None] + (high - low)[:, None] * (share if round_ == 0 else share[:-1])
        at = start[:, None] + along[..., None] * normals[:, None]
        facing = np.broadcast_to(border.crease[:, None], along.shape)
        hits = caster.cast(camera, T_world_cam, at, among=patch.among, facing=facing)
        within = border.on_near_side(hits.object == index, hits.depth, hits.normal)
        passed = np.logical_and.accumulate(within, axis=1).sum(axis=1)
        last = np.maximum(passed - 1, 0)
        some, all_ = passed > 0, passed == along.shape[1]
        beyond_near = hits.depth[:, -1] > near
        near = np.where(some, hits.depth[rows, last], near)
        high = np.where(all_, high, along[rows, np.minimum(passed, along.shape[1] - 1)])
        low = np.where(some, along[rows, last], low)
        if round_ == 0:
            valid = ~within[:, -1] & (beyond_near | (sides.kind == Kind.CREASE))
            start, normals, near = start[valid], normals[valid], near[valid]
            low, high = low[valid], high[valid]
            sides, border = sides.only(valid), border.only(valid)
    if len(start) < 8:
        return None
    pixels = start + ((low + high) / 2)[:, None] * normals
    points = T_world_cam @ camera.unproject(pixels, near)
    return Contour(pixels, normals, points, sides.kind, thinning)


@dataclass(frozen=True, eq=False)
class _Border:
    """Criteria that separate the near side of each of N contour pixels from the other side.

    Attributes:
        inner, crease: (N,) the kinds of contour inside the object.
        depth: (N,) between the near surface and the far one.
        axis: (N, 3) from the other side's normal to the near side's.
    """

    inner: Flags
    crease: Flags
    depth: Array
    axis: Array32

    @staticmethod
    def of(depth: Array32, normal: Array32, sides: _Sides) -> _Border:
        near = depth[sides.v, sides.u].astype(np.float64)
        # Halfway between the near surface and the far one.
        far = np.minimum(depth[sides.other_v, sides.other_u], near + 10.0)
        axis = normal[sides.v, sides.u] - normal[sides.other_v, sides.other_u]
        kind = sides.kind
        return _Border(kind == Kind.INNER, kind == Kind.CREASE, (near + far) / 2, axis)

    def only(self, chosen: Flags) -> _Border:
        """Those of some of the pixels."""
        return _Border(
            self.inner[chosen], self.crease[chosen], self.depth[chosen], self.axis[chosen]
        )

    def on_near_side(self, is_object: Flags, depth: Array32, normal: Array32) -> Flags:
        """(N, M) for M points of each contour pixel, of which `is_object` and so on are known."""
        near = is_object.copy()
        near[self.inner] &= depth[self.inner] < self.depth[self.inner, None]
        axis = self.axis[self.crease, None]
        near[self.crease] &= (normal[self.crease] * axis).sum(axis=-1) > 0
        return near

    def on_near_side_at(
        self, is_object: Flags, depth: Array32, normal: Array32, at: NDArray[np.intp]
    ) -> Flags:
        """The same for pixels of an image, by their flat indices (N, M)."""
        near = is_object.copy()
        inner, crease = self.inner, self.crease
        near[inner] &= depth.ravel()[at[inner]] < self.depth[inner, None]
        v, u = np.divmod(at[crease], depth.shape[1])
        near[crease] &= (normal[v, u] * self.axis[crease, None]).sum(axis=-1) > 0
        return near


def contour_image(patch: Patch) -> Array32:
    """(h, w) 1 on every predicted contour of any object, 0 elsewhere."""
    depth = np.where(patch.hits.object >= 0, patch.hits.depth, np.float32(1e3))
    edge = np.zeros(depth.shape, np.float32)
    for a, i, d, n in zip(
        _both_ways(edge),
        _both_ways(patch.hits.object),
        _both_ways(depth),
        _both_ways(np.moveaxis(patch.hits.normal, -1, 0)),
        strict=True,
    ):
        changed = (i[1:] != i[:-1]) | (np.abs(d[1:] - d[:-1]) > 0.012)
        changed |= (i[1:] >= 0) & (_cosine(n[:, 1:], n[:, :-1]) < _CREASE_COSINE)
        a[1:][changed] = 1
        a[:-1][changed] = 1
    return edge


def _both_ways(image: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Views of an image (..., h, w) with rows, or columns, as the next-to-last axis."""
    return image, image.swapaxes(-1, -2)


def _cosine(a: Array32, b: Array32) -> Array32:
    """(...) of unit vectors (3, ...): component by component, which is several times as fast."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


# `_find` records for each pixel the neighbour on the other side of its contour, as (v, u).
_TOWARD = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])


def _find(mask: Flags, depth: Array32, normal: Array32, footprint: float) -> _Sides:
    """Pixels of the object with a contour to one of their four neighbours, the largest step."""
    threshold = max(_SMALLEST_JUMP_M, _SMALLEST_JUMP_FOOTPRINTS * footprint)
    # Only the object with a margin of one pixel is needed.
    v, u = (np.flatnonzero(mask.any(axis=k)) for k in (1, 0))
    top, left = max(v[0] - 1, 0), max(u[0] - 1, 0)
    box = slice(top, v[-1] + 2), slice(left, u[-1] + 2)
    masks = _both_ways(mask[box])
    depths = _both_ways(depth[box])
    normals = _both_ways(np.moveaxis(normal[box], -1, 0))
    best = np.zeros(masks[0].shape, np.float32)
    kinds = np.full(best.shape, -1, np.int8)
    toward = np.zeros(best.shape, np.int8)
    bests, all_kinds, towards = _both_ways(best), _both_ways(kinds), _both_ways(toward)

    def note(axis: int, direction: int, kind: Kind, where: Flags, step: Array32 | float) -> None:
        inner = slice(1, -1)
        b, k, t = (x[axis][::direction][inner] for x in (bests, all_kinds, towards))
        better = where & (step > b)
        np.copyto(b, np.float32(step) if isinstance(step, float) else step, where=better)
        np.copyto(k, np.int8(kind), where=better)
        np.copyto(t, np.int8(2 * axis + (direction < 0)), where=better)

    steps = {}
    for axis, direction in ((0, 1), (0, -1), (1, 1), (1, -1)):
        m, d = masks[axis][::direction], depths[axis][::direction]
        step = steps[axis, direction] = d[2:] - d[1:-1]
        note(axis, direction, Kind.SILHOUETTE, m[1:-1] & ~m[2:] & (step > 0), step)
    # Next to the silhouette surfaces are grazing: an apparent step there is not one.
    outer = (kinds == Kind.SILHOUETTE).astype(np.uint8)
    free = _both_ways(cv2.dilate(outer, np.ones((5, 5), np.uint8)) == 0)
    same = [m[1:-1] & m[2:] & m[:-2] & f[1:-1] for m, f in zip(masks, free, strict=True)]
    for (axis, direction), step in steps.items():
        # The slope of a slanted surface is not a step.
        slope = np.maximum(-steps[axis, -direction][::-1], 0)
        hides = step - slope > threshold
        note(axis, direction, Kind.INNER, same[axis][::direction] & hides, step)
    for axis in (0, 1):
        n, flat = normals[axis], np.abs(steps[axis, 1]) < threshold
        crease = same[axis] & flat & (_cosine(n[:, 2:], n[:, 1:-1]) < _CREASE_COSINE)
        note(axis, 1, Kind.CREASE, crease, 1e-6)
    v, u = np.nonzero(kinds >= 0)
    other = _TOWARD[toward[v, u]]
    kind = kinds[v, u]
    v, u = v + top, u + left
    return _Sides(v, u, v + other[:, 0], u + other[:, 1], kind)


def _normals(
    mask: Flags, depth: Array32, normal: Array32, sides: _Sides, border: _Border
) -> tuple[Array, Flags]:
    """Outward unit normals (N, 2) from the centre of mass of the near side, and which are clear."""
    rows = sides.v[:, None] + _AROUND[None, :, 1]
    columns = sides.u[:, None] + _AROUND[None, :, 0]
    h, w = mask.shape
    known = (rows >= 0) & (rows < h) & (columns >= 0) & (columns < w)
    at = np.where(known, rows * w + columns, 0)
    near = border.on_near_side_at(mask.ravel()[at] & known, depth, normal, at)
    moment = (near * _BELL) @ _AROUND
    length = np.linalg.norm(moment, axis=1)
    normals = -moment / np.maximum(length, 1e-9)[:, None]
    return normals, length > 0.15 * _BELL.sum()
