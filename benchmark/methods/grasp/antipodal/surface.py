"""Points and normals of objects on the table, from a depth map.

Estimates the table plane if it is not given.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.methods.protocol import GraspView
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, unproject_depth

Floats = NDArray[np.float64]

# Higher than anything that a table-top camera is to grasp.
_HIGHEST_M = 0.5

# Neighbours within this distance make a point's normal; as many must there be at least.
_NORMAL_RADIUS_M = 0.008

_LEAST_NEIGHBOURS = 6

_LARGEST_WINDOW = 5

# With fewer near neighbours in the image a point hangs in the air: sensors make such ones at edges.
_LONE_NEIGHBOURS = 3

# What lies behind by more is something else, or the other side of a vessel.
_STEP_M = 0.02

# The neighbours of a place at an edge have their middle this far to one side at least.
_ONE_SIDED_M = 0.0015

# Share of a piece that must be as high as a thing.
_HIGH_SHARE = 0.05

_POINTS = 20_000

_DISTANCE_M = 0.005

_ROUNDS = 300

# A table that is seen at all fills so much of the view.
_LEAST_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class Surface:
    """What is seen of the objects, in the table's frame (z up, table at z = 0).

    Attributes:
        points, normals: (C, 3) places where fingers might touch, normals out of the object.
        at_edge: (C,) bool what lies beside the place in the image lies far behind it.
        outwards: (C, 3) unit vectors along the surface, away from where it goes on: out over the
            edge, for places at one; 0 where the surface goes on all around.
        obstacles: (P, 3) all points of things above the table.
        eye: (3,) the camera.
    """

    points: Floats
    normals: Floats
    at_edge: NDArray[np.bool_]
    outwards: Floats
    obstacles: Floats
    eye: Floats


def surface_of(
    view: GraspView,
    T_cam_table: SE3,
    *,
    least_height: float,
    least_top: float,
    least_area: float,
    count: int,
    rng: np.random.Generator,
) -> Surface:
    """What stands on the table.

    Args:
        view: of which the pixels of the mask, or all, are looked at.
        T_cam_table: the table.
        least_height: metres above the table.
        least_top, least_area: see `things`.
        count: largest number of contacts.
        rng: thins them out.
    """
    T = T_cam_table.inverse()
    known = np.isfinite(view.depth) & (view.depth > 0)
    depth = np.where(known, view.depth, 0)
    places = T @ unproject_depth(depth, view.camera)
    above = known & (places[..., 2] > least_height) & (places[..., 2] < _HIGHEST_M)
    area = depth.astype(np.float64) ** 2 / (view.camera.fx * view.camera.fy)
    above = things(above, places[..., 2], area, least_top=least_top, least_area=least_area)
    graspable = above if view.mask is None else above & view.mask
    # In pixels, about half the radius of the normals.
    focal = (view.camera.fx + view.camera.fy) / 2
    usual = float(np.median(depth[graspable])) if graspable.any() else 1.0
    window = int(np.clip(round(_NORMAL_RADIUS_M / 1.5 * focal / usual), 1, _LARGEST_WINDOW))
    chosen = _thinned(places, graspable, count, rng)
    points, normals, ahead, neighbours = _normals(places, known, chosen, window)
    at_edge = _beside_step(depth, known, chosen, window)
    facing = np.einsum("ni,ni->n", normals, T.t - points)
    normals = np.where(facing[:, None] < 0, -normals, normals)
    good = neighbours >= _LEAST_NEIGHBOURS
    solid = above & (_near_count(places, known) >= _LONE_NEIGHBOURS)
    return Surface(
        points[good], normals[good], at_edge[good], _outwards(normals, ahead)[good],
        places[solid], T.t,
    )  # fmt: skip


def things(
    above: NDArray[np.bool_],
    height: Floats,
    area: Floats,
    *,
    least_top: float,
    least_area: float,
) -> NDArray[np.bool_]:
    """Pixels of pieces that are large and high enough to be an object.

    Depth that was measured or restored badly has low bumps and specks on the bare table.

    Args:
        above: (h, w) pixels above the table; neighbours, also diagonal ones, make a piece.
        height: (h, w) metres above the table.
        area: (h, w) square metres that a pixel covers, seen from the camera.
        least_top: metres; the highest twentieth of a piece lies above it.
        least_area: square metres of a piece.

    Returns:
        (h, w) bool.

    >>> above = np.array([[1, 1, 0, 1], [1, 1, 0, 0]], bool)
    >>> things(above, 0.02 * above, 1e-4 * above, least_top=0.01, least_area=2e-4).astype(int)
    array([[1, 1, 0, 0],
           [1, 1, 0, 0]])
    """
    count, pieces = cv2.connectedComponents(above.astype(np.uint8), connectivity=8)
    kept = np.bincount(pieces.ravel(), weights=area.ravel(), minlength=count) >= least_area
    high = np.bincount(pieces.ravel(), weights=(height > least_top).ravel(), minlength=count)
    kept &= high >= _HIGH_SHARE * np.bincount(pieces.ravel(), minlength=count)
    kept[0] = False
    return np.asarray(kept[pieces])


def _thinned(
    places: Floats, allowed: NDArray[np.bool_], count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """(K, 2) rows and columns of at most `count` pixels, evenly spread over the surface."""
    rows = np.argwhere(allowed)
    rows = rows[rng.permutation(len(rows))]
    size = 0.002
    while len(rows) > count:
        cells = np.floor(places[rows[:, 0], rows[:, 1]] / size).astype(np.int64)
        rows = rows[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
        size *= 1.2
    return rows


def _normals(
    places: Floats, known: NDArray[np.bool_], chosen: NDArray[np.int64], window: int
) -> tuple[Floats, Floats, Floats, NDArray[np.int64]]:
    """Points, normals and way to the middle of the neighbours (K, 3), and their number (K,).

    The plane through the neighbours in the image that are near in space too: the two sides of a
    thin wall are near in space alone.
    """
    height, width = known.shape
    points = places[chosen[:, 0], chosen[:, 1]]
    total = np.zeros(len(points))
    first, second = np.zeros((len(points), 3)), np.zeros((len(points), 3, 3))
    for dv in range(-window, window + 1):
        for du in range(-window, window + 1):
            v, u = chosen[:, 0] + dv, chosen[:, 1] + du
            there = (v >= 0) & (v < height) & (u >= 0) & (u < width)
            v, u = np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)
            away = places[v, u] - points
            weight = there & known[v, u] & ((away**2).sum(axis=1) < _NORMAL_RADIUS_M**2)
            away *= weight[:, None]
            total += weight
            first += away
            second += away[:, :, None] * away[:, None, :]
    share = np.maximum(total, 1)
    mean = first / share[:, None]
    spread = second / share[:, None, None] - mean[:, :, None] * mean[:, None, :]
    normals = np.linalg.eigh(spread)[1][:, :, 0]
    return points, normals, mean, total.astype(np.int64)


def _outwards(normals: Floats, ahead: Floats) -> Floats:
    """(K, 3) unit vectors along the surface away from its other points, 0 where they are all
    around."""
    along = ahead - np.einsum("ni,ni->n", ahead, normals)[:, None] * normals
    length = np.linalg.norm(along, axis=1, keepdims=True)
    one_sided = length > _ONE_SIDED_M
    return np.where(one_sided, -along / np.maximum(length, 1e-12), 0)


def _beside_step(
    depth: NDArray[np.float32], known: NDArray[np.bool_], chosen: NDArray[np.int64], window: int
) -> NDArray[np.bool_]:
    """(K,) pixels with one in their window that lies behind by more than a step."""
    far = cv2.dilate(
        np.where(known, depth, 0).astype(np.float32),
        np.ones((2 * window + 1, 2 * window + 1), np.uint8),
    )
    v, u = chosen.T
    return np.asarray(far[v, u] - depth[v, u] > _STEP_M)


def _near_count(places: Floats, known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(h, w) how many of the 8 neighbours lie within 1 cm."""
    count = np.zeros(known.shape, dtype=np.int64)
    padded = np.pad(places, ((1, 1), (1, 1), (0, 0)))
    there = np.pad(known, 1)
    height, width = known.shape
    for dv in range(3):
        for du in range(3):
            if (dv, du) == (1, 1):
                continue
            other = padded[dv : dv + height, du : du + width]
            near = ((other - places) ** 2).sum(axis=-1) < 0.01**2
            count += near & there[dv : dv + height, du : du + width] & known
    return count


def table_of(view: GraspView, rng: np.random.Generator) -> SE3:
    """T_cam_table of a view: as given, or found in its depth."""
    if view.T_cam_table is not None:
        return SE3.from_matrix(view.T_cam_table)
    return find_table(view.depth, view.camera, not_table=view.mask, rng=rng)


def find_table(
    depth: NDArray[np.float32],
    camera: Camera,
    *,
    not_table: NDArray[np.bool_] | None = None,
    rng: np.random.Generator,
) -> SE3:
    """Pose of the largest plane, T_cam_table: z towards the camera's side, origin on the axis.

    Args:
        depth: (h, w) metres, 0 unknown.
        not_table: (h, w) pixels to leave out, such as those of objects.
        rng: draws the planes that are tried.

    Raises:
        ToolkitError: no plane holds a tenth of the points.
    """
    known = np.isfinite(depth) & (depth > 0)
    if not_table is not None and (known & ~not_table).sum() >= 3:
        known &= ~not_table
    points = unproject_depth(np.where(known, depth, 0), camera)[known]
    if len(points) < 3:
        raise ToolkitError("too little depth to find the table in", value=len(points))
    points = points[rng.permutation(len(points))[:_POINTS]]
    corners = points[rng.integers(len(points), size=(_ROUNDS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    usable = length > 1e-9
    if not usable.any():
        raise ToolkitError("the points lie on a line: there is no table in them")
    normals, corners = normals[usable] / length[usable, None], corners[usable]
    offsets = np.einsum("ni,ni->n", normals, corners[:, 0])
    holds = [np.abs(points @ n - d) < _DISTANCE_M for n, d in zip(normals, offsets, strict=True)]
    best = max(holds, key=np.count_nonzero)
    if best.mean() < _LEAST_SHARE:
        raise ToolkitError(
            "no table is seen: no plane holds a tenth of the points",
            value=round(float(best.mean()), 3),
            hint="give its pose, T_cam_table",
        )
    middle = points[best].mean(axis=0)
    normal = np.linalg.svd(points[best] - middle, full_matrices=False)[2][2]
    up = normal if normal @ middle < 0 else -normal
    x = np.array([1.0, 0, 0]) - up[0] * up
    x /= np.linalg.norm(x)
    return SE3(np.stack([x, np.cross(up, x), up], axis=1), middle)
