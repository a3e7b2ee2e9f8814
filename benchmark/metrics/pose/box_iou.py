"""Oriented boxes: corners, and their intersection over union in three definitions.

The volume that two boxes at any pose have in common is exact, for many pairs at once. In
coordinates in which box A is the cube [-1, 1]^3, box B is a parallelepiped. The field
F = (clamp(x, -1, 1), 0, 0), taken as zero where |y| > 1 or |z| > 1, has divergence 1 inside the
cube and 0 elsewhere, so that by the divergence theorem the common volume is the flux of F out of
B: a sum over the six faces of B alone. Each is projected along x, clipped by the four lines of the
square, and split at x = 1 and x = -1, where F is linear in each part.

Faces of A never enter. Methods that add up the faces of the common polyhedron must decide whose
face counts where two faces coincide, and are wrong by whole boxes when rounding decides it twice
in different ways; here the answer depends continuously on both boxes.
"""

from enum import Enum
from itertools import product

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

_SIGNS = np.array(list(product((1.0, -1.0), repeat=3))).T

Floats = NDArray[np.float64]

# Polygons of this many pairs stay in the cache of a core.
_PAIRS_AT_ONCE = 1024


def box_corners(RT: Floats, sizes: Floats) -> Floats:
    """Corners of boxes in the camera frame.

    Args:
        RT: (..., 4, 4) object to camera, the scale inside.
        sizes: (..., 3) along x, y, z before RT.

    Returns:
        (..., 3, 8) in metres; corners of two boxes at one index have the same signs of x, y, z.

    Raises:
        ValueError: shapes that do not go together.

    >>> box_corners(np.eye(4), np.array([2.0, 4.0, 6.0])).max(axis=-1).tolist()
    [1.0, 2.0, 3.0]
    """
    return RT[..., :3, :3] @ (sizes[..., :, None] / 2 * _SIGNS) + RT[..., :3, 3:]


def cube_to_box(RT: Floats, sizes: Floats) -> Floats:
    """Maps of the cube [-1, 1]^3 onto boxes.

    Args:
        RT: (..., 4, 4) object to camera, the scale inside.
        sizes: (..., 3) along x, y, z before RT.

    Returns:
        (..., 4, 4) in metres.

    Raises:
        ValueError: shapes that do not go together.

    >>> np.diag(cube_to_box(np.eye(4), np.array([2.0, 4.0, 6.0]))).tolist()
    [1.0, 2.0, 3.0, 1.0]
    """
    half = np.concatenate([sizes / 2, np.ones((*sizes.shape[:-1], 1))], axis=-1)
    return RT * half[..., None, :]


def turned_about_y(RT: Floats, turns: int) -> Floats:
    """Poses after equal parts of a full turn about the object's y axis.

    Args:
        RT: (N, 4, 4).
        turns: number of parts.

    Returns:
        (N, turns, 4, 4), the pose itself first.

    Raises:
        ValueError: shapes that do not go together.

    >>> turned_about_y(np.eye(4)[None], 2)[0, 1].round().diagonal().tolist()
    [-1.0, 1.0, -1.0, 1.0]
    """
    angle = 2 * np.pi * np.arange(turns) / turns
    Y = np.tile(np.eye(4), (turns, 1, 1))
    Y[:, 0, 0] = Y[:, 2, 2] = np.cos(angle)
    Y[:, 0, 2] = np.sin(angle)
    Y[:, 2, 0] = -Y[:, 0, 2]
    return RT[:, None] @ Y


class BoxIoU(Enum):
    """What overlap of two boxes means.

    Attributes:
        ORIENTED: the common volume of the boxes themselves, exact.
        AABB: of the boxes around them along the camera's axes, which grow as an object turns
            (the later half of the field, DREDS and CATRE among it).
        NOCS2019: of eight intervals, one for each corner, from its least to its largest coordinate
            (NOCS' released evaluation takes minimum and maximum over the wrong axis, and most of
            the field's figures until 2022 come from it).
    """

    ORIENTED = "oriented"
    AABB = "aabb"
    NOCS2019 = "nocs2019"


def box_iou(
    RT_a: Floats,
    sizes_a: Floats,
    RT_b: Floats,
    sizes_b: Floats,
    definition: BoxIoU = BoxIoU.ORIENTED,
    *,
    round_about_y: NDArray[np.bool_] | None = None,
    turns: int = 20,
) -> Floats:
    """Overlap of boxes, pair by pair.

    Args:
        RT_a, RT_b: (N, 4, 4) object to camera, the scale inside, metres.
        sizes_a, sizes_b: (N, 3) of the boxes along x, y, z before RT.
        definition: of the overlap.
        round_about_y: (N,) pairs whose object looks the same after a turn about y: the best of
            `turns` turns of box a counts. None of them by default.
        turns: equal parts of a full turn.

    Returns:
        (N,) overlaps in [0, 1]; 0 for boxes without volume.

    Raises:
        ToolkitError: shapes that do not belong together, or no turns.

    >>> moved = np.eye(4)[None].copy()
    >>> moved[0, 0, 3] = 0.5
    >>> cube = np.ones((1, 3))
    >>> box_iou(np.eye(4)[None], cube, moved, cube).round(6).tolist()  # 0.5 of 1.5
    [0.333333]
    """
    a, b = (np.asarray(x, dtype=np.float64) for x in (RT_a, RT_b))
    size_a, size_b = (np.asarray(x, dtype=np.float64) for x in (sizes_a, sizes_b))
    n = len(a)
    shapes = (a.shape, size_a.shape, b.shape, size_b.shape)
    if shapes != ((n, 4, 4), (n, 3), (n, 4, 4), (n, 3)) or turns < 1:
        raise ToolkitError("needs poses (N, 4, 4), sizes (N, 3) and turns", value=(shapes, turns))
    turning = np.zeros(n, dtype=bool) if round_about_y is None else np.asarray(round_about_y)
    if turning.shape != (n,):
        raise ToolkitError("must have shape (N,)", field="round_about_y", value=turning.shape)
    overlap = np.empty(n)
    still = ~turning
    overlap[still] = _iou(a[still], size_a[still], b[still], size_b[still], definition)
    if turning.any():
        many = turned_about_y(a[turning], turns).reshape(-1, 4, 4)
        own, other, its = (np.repeat(x[turning], turns, axis=0) for x in (size_a, b, size_b))
        found = _iou(many, own, other, its, definition)
        overlap[turning] = found.reshape(-1, turns).max(axis=1)
    return overlap


def _iou(a: Floats, size_a: Floats, b: Floats, size_b: Floats, definition: BoxIoU) -> Floats:
    if definition is BoxIoU.ORIENTED:
        A, B = cube_to_box(a, size_a), cube_to_box(b, size_b)
        common = common_volume(A, B)
        volumes = [8 * np.abs(np.linalg.det(M[:, :3, :3])) for M in (A, B)]
    else:
        axis = 2 if definition is BoxIoU.AABB else 1
        corners = box_corners(a, size_a), box_corners(b, size_b)
        low = [c.min(axis=axis) for c in corners]
        high = [c.max(axis=axis) for c in corners]
        sides = np.minimum(*high) - np.maximum(*low)
        common = np.where((sides < 0).any(axis=1), 0.0, sides.prod(axis=1))
        volumes = [(h - w).prod(axis=1) for h, w in zip(high, low, strict=True)]
    union = volumes[0] + volumes[1] - common
    return np.divide(common, union, out=np.zeros(len(a)), where=union > 0)


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
