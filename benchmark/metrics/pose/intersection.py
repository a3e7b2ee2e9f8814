"""Exact volume that two boxes at any pose have in common, for many pairs at once.

In coordinates in which box A is the cube [-1, 1]^3, box B is a parallelepiped. The field
F = (clamp(x, -1, 1), 0, 0), taken as zero where |y| > 1 or |z| > 1, has divergence 1 inside the
cube and 0 elsewhere, so that by the divergence theorem the common volume is the flux of F out of
B: a sum over the six faces of B alone. Each is projected along x, clipped by the four lines of the
square, and split at x = 1 and x = -1, where F is linear in each part.

Faces of A never enter. Methods that add up the faces of the common polyhedron must decide whose
face counts where two faces coincide, and are wrong by whole boxes when rounding decides it twice
in different ways; here the answer depends continuously on both boxes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]

# Polygons of this many pairs stay in the cache of a core.
_PAIRS_AT_ONCE = 1024


def common_volume(A: Floats, B: Floats) -> Floats:
    """Volume of the intersection of boxes, pair by pair.

    Args:
        A, B: (N, 4, 4) affine maps of the cube [-1, 1]^3 onto the boxes.

    Returns:
        (N,) volumes in the unit of the boxes, cubed; 0 for boxes without volume.

    Raises:
        ToolkitError: shapes other than these.

    >>> one, two = np.eye(4)[None], np.eye(4)[None].copy()
    >>> two[0, :3, 3] = 1.0, 0.0, 0.5
    >>> common_volume(one, two).tolist()  # 1 x 2 x 1.5
    [3.0]
    """
    if A.shape != B.shape or A.shape[1:] != (4, 4):
        raise ToolkitError("needs two equal arrays (N, 4, 4)", value=(A.shape, B.shape))
    volume = np.zeros(len(A))
    det_A, det_B = (np.abs(np.linalg.det(M[:, :3, :3])) for M in (A, B))
    # Half diagonals bound the boxes: spheres that are apart hold boxes that are apart.
    reach = sum(np.sqrt((M[:, :3, :3] ** 2).sum(axis=(1, 2))) * np.sqrt(3) for M in (A, B))
    apart = np.linalg.norm(A[:, :3, 3] - B[:, :3, 3], axis=1) > reach
    candidates = np.flatnonzero((det_A > 0) & (det_B > 0) & ~apart)
    for begin in range(0, len(candidates), _PAIRS_AT_ONCE):
        index = candidates[begin : begin + _PAIRS_AT_ONCE]
        inverse = np.linalg.inv(A[index, :3, :3])
        edges = inverse @ B[index, :3, :3]
        centre = (inverse @ (B[index, :3, 3] - A[index, :3, 3])[:, :, None])[:, :, 0]
        in_cube = _cube_and_parallelepiped(centre, edges)
        most = np.minimum(det_A[index], det_B[index]) * 8
        volume[index] = np.clip(in_cube * det_A[index], 0, most)
    return volume


def _cube_and_parallelepiped(centre: Floats, edges: Floats) -> Floats:
    """(N,) volume common to [-1,1]^3 and centre (N,3) + edges (N,3,3) [-1,1]^3."""
    n = len(centre)
    polygons = _faces(centre, edges)
    pair = np.tile(np.arange(n), 6)
    for axis in (1, 2):
        for sign in (1.0, -1.0):
            polygons, kept = _clip(polygons, axis, sign)
            pair = pair[kept]
    # Of the part beyond x = 1 the flux is its area, of that beyond x = -1 minus its area.
    flux = _sum_by(pair, _area(polygons), n)
    polygons, kept = _clip(polygons, 0, 1.0)
    pair = pair[kept]
    flux -= 2 * _sum_by(pair, _area(polygons), n)
    polygons, kept = _clip(polygons, 0, -1.0)
    pair = pair[kept]
    flux += _sum_by(pair, _area(polygons) + _integral_of_x(polygons), n)
    return np.abs(flux)


def _faces(centre: Floats, edges: Floats) -> Floats:
    """(3, 4, 6N) corners of the faces, each outside seen counter-clockwise (or each clockwise)."""
    faces = []
    for i in range(3):
        e, u, v = (edges[:, :, (i + k) % 3].T for k in range(3))
        for side in (1.0, -1.0):
            middle = centre.T + side * e
            # The opposite face is run through in the other direction.
            corners = [middle - u - side * v, middle + u - side * v]
            corners += [middle + u + side * v, middle - u + side * v]
            faces.append(np.stack(corners, axis=1))
    return np.concatenate(faces, axis=2)


def _clip(polygons: Floats, axis: int, sign: float) -> tuple[Floats, NDArray[np.intp]]:
    """Keep what has sign * coordinate <= 1.

    Args:
        polygons: (3, K, M) corners of convex polygons, the last ones repeated at will.
        axis: of the coordinate.
        sign: 1 or -1.

    Returns:
        (3, K + 1, L) polygons that are left, and which of the M they are; K where none is cut.
    """
    distance = 1.0 - sign * polygons[axis]
    inside = distance >= 0
    count = inside.sum(axis=0)
    size = inside.shape[0]
    kept = np.flatnonzero(count > 0)
    cut = np.flatnonzero((count > 0) & (count < size))
    if not len(cut):
        return (polygons if len(kept) == len(count) else polygons[:, :, kept]), kept
    inside, distance, count = inside[:, cut], distance[:, cut], count[cut]
    # Roll each polygon so that its inside corners come first; they are a run, it is convex.
    entering = inside & ~np.roll(inside, 1, axis=0)
    order = (np.argmax(entering, axis=0) + np.arange(size)[:, None]) % size
    corners = np.take_along_axis(polygons[:, :, cut], order[None], axis=1)
    distance = np.take_along_axis(distance, order, axis=0)
    column = np.arange(len(cut))
    leaving = _crossing(corners, distance, count - 1, count, column)
    coming = _crossing(corners, distance, np.full_like(count, size - 1), 0 * count, column)
    row = np.arange(size + 1)[:, None]
    padded = np.concatenate([corners, corners[:, -1:]], axis=1)
    clipped = np.where(row < count, padded, coming[:, None])
    clipped[:, count, column] = leaving
    result = np.empty((3, size + 1, len(kept)))
    result[:, :size] = polygons[:, :, kept]
    result[:, size] = result[:, size - 1]
    result[:, :, np.searchsorted(kept, cut)] = clipped
    return result, kept


def _crossing(
    corners: Floats,
    distance: Floats,
    start: NDArray[np.intp],
    end: NDArray[np.intp],
    column: NDArray[np.intp],
) -> Floats:
    """(3, M) where the edges from corner `start` to corner `end` cross the line."""
    a, b = distance[start, column], distance[end, column]
    t = a / (a - b)
    p, q = corners[:, start, column], corners[:, end, column]
    return p + t * (q - p)


def _area(polygons: Floats) -> Floats:
    """(M,) signed areas in the plane of y and z."""
    return _fans(polygons).sum(axis=0) / 2


def _integral_of_x(polygons: Floats) -> Floats:
    """(M,) integrals of x over the polygons as seen along x, with the sign of the area."""
    x = polygons[0]
    return (_fans(polygons) * (x[1:-1] + x[2:] + x[0])).sum(axis=0) / 6


def _fans(polygons: Floats) -> Floats:
    """(K - 2, M) twice the areas of the triangles with the first corner."""
    y, z = polygons[1] - polygons[1, :1], polygons[2] - polygons[2, :1]
    return y[1:-1] * z[2:] - z[1:-1] * y[2:]


def _sum_by(pair: NDArray[np.intp], values: Floats, n: int) -> Floats:
    return np.bincount(pair, weights=values, minlength=n).astype(np.float64, copy=False)
