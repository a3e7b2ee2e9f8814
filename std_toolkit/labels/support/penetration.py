"""Detection of placed objects that penetrate each other or the table, and their separation.

Points sampled on the surface of one object are tested against the volume of the other by ray
casting (`Solid.inside`). Objects in the cavity of another one, such as a spoon in a mug, do not
penetrate it. Scans have holes, so the fraction of the rays that agree is part of the result. A
widely open mesh, such as a cup one triangle thick, has no inside; objects that penetrate it are
found by the part of it inside them.

Separation is the shortest translation found that resolves a penetration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support.plane import Plane
from std_toolkit.labels.support.resting import sphere_directions
from std_toolkit.labels.support.solid import PlacedObject, Samples, Solid
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

TABLE = "table"

# Number of points of one object that are tested against another; the first are evenly spread.
_MOST_ASKED = 800

# Number of these whose depth is measured, beginning with those that may be deepest.
_MOST_MEASURED = 96

# Further points, for display only, take the result of the nearest tested one.
_MOST_PAINTED = 3000


# Number of points by which each direction is compared.
_ASKED = 200

_DIRECTIONS = 24

# Number of best directions that are followed until the objects are separate.
_TRIED = 5

# Added to a separation, so that the next test finds none.
_CLEARANCE_M = 0.0001


@dataclass(frozen=True, kw_only=True)
class PenetrationSettings(Settings):
    """Which penetrations are certain."""

    sure: float = limit(0.9, source=NOT_RECORDED)
    """with a smaller fraction of rays that report inside, a penetration is uncertain"""


@dataclass(frozen=True, eq=False)
class Surface:
    """The part of the surface of an object that is inside the other one.

    Attributes:
        vertices: (N,) indices of the vertices inside.
        faces: (M,) indices of the faces with such a vertex or a sampled point inside.
        points: (K, 3) sampled points inside, common frame, metres.
    """

    vertices: NDArray[np.int64]
    faces: NDArray[np.int64]
    points: Array


@dataclass(frozen=True, eq=False)
class Penetration:
    """Two objects that overlap.

    Attributes:
        first, second: names; `second` may be the table (`TABLE`).
        depth_m: depth of the deepest point found below the surface of the other object, metres.
        first_surface, second_surface: parts inside the other object; empty for the table.
        certainty: fraction of the rays that report these points as inside, 0.5 to 1. Below 0.9 a
            mesh has holes or inner faces there, and the result needs a visual check.
    """

    first: str
    second: str
    depth_m: float
    first_surface: Surface
    second_surface: Surface
    certainty: float
    _separate: Callable[[], Array] = field(repr=False)

    @cached_property
    def separation(self) -> Array:
        """(3,) translation of `first` that resolves it, common frame, metres.

        Does not move the object into the table, if that is known. Computed on first access.
        """
        return self._separate()

    @property
    def sure(self) -> bool:
        return self.certainty >= PenetrationSettings.current().sure


def find_penetrations(
    objects: Sequence[PlacedObject], *, plane: Plane | None = None, tolerance_m: float = 0.0005
) -> list[Penetration]:
    """Find the pairs of objects that penetrate each other, and objects that penetrate the table.

    Data derived from a mesh are computed on first use and cached (`prepare_objects`).

    Args:
        objects: meshes at their poses in one frame, with unique names.
        plane: the table in the same frame, normal up; None to leave it out.
        tolerance_m: smaller depths are ignored, because contacts are never exact.

    Returns:
        Penetrations in descending order of depth.
    """
    found = []
    for a, b in combinations(objects, 2):
        if not _spheres_meet(a, b):
            continue
        pair = _pair(a, b, plane, tolerance_m)
        if pair is not None:
            found.append(pair)
    if plane is not None:
        found += [p for t in objects if (p := _in_table(t, plane, tolerance_m)) is not None]
    return sorted(found, key=lambda p: -p.depth_m)


def prepare_objects(objects: Sequence[PlacedObject]) -> None:
    """Compute and cache the mesh data for `find_penetrations`; a fraction of a second each."""
    for obj in objects:
        obj.solid.prepare()


def _spheres_meet(a: PlacedObject, b: PlacedObject) -> bool:
    middles = [t.T_frame_obj @ (t.solid.centre + (t.solid.low + t.solid.high) / 2) for t in (a, b)]
    reach = sum(float(np.linalg.norm(t.solid.high - t.solid.low)) / 2 for t in (a, b))
    return float(np.linalg.norm(middles[0] - middles[1])) < reach


def _pair(
    a: PlacedObject, b: PlacedObject, plane: Plane | None, tolerance_m: float
) -> Penetration | None:
    T_b_a = _centred(b).inverse() @ _centred(a)
    of_a = _inside(a.solid, b.solid, T_b_a, tolerance_m)
    of_b = _inside(b.solid, a.solid, T_b_a.inverse(), tolerance_m)
    if len(of_a.points) + len(of_b.points) == 0:
        return None
    depth = max(_deepest(b.solid, of_a.points), _deepest(a.solid, of_b.points))
    if depth <= tolerance_m:
        return None

    def way() -> Array:
        up = None if plane is None else b.T_frame_obj.R.T @ plane.normal
        step = separate(a.solid, b.solid, T_b_a, of_a.points, of_b.points, up=up)
        return b.T_frame_obj.R @ step

    votes = np.concatenate([of_a.votes, of_b.votes])
    return Penetration(
        a.name,
        b.name,
        depth,
        _surface(a, of_a.samples),
        _surface(b, of_b.samples),
        float(votes.mean()),
        way,
    )


@dataclass(frozen=True, eq=False)
class _Inner:
    """The part of a solid inside another one.

    Attributes:
        points: (N, 3) samples found inside, in the centred frame of the other solid.
        votes: (N,) fraction of the rays that report inside.
        samples: (K,) indices of these samples, and of untested samples next to them.
    """

    points: Array
    votes: Array
    samples: NDArray[np.int64]


def _inside(of: Solid, within: Solid, T_within_of: SE3, tolerance_m: float) -> _Inner:
    if not _boxes_meet(of, within, T_within_of):
        return _Inner(np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64))
    candidates = _in_box(of.samples.points, within, T_within_of, tolerance_m)
    asked, left = candidates[:_MOST_ASKED], candidates[_MOST_ASKED:_MOST_PAINTED]
    points = T_within_of @ of.samples.points[asked].astype(np.float64)
    verdict, votes = within.inside(points)
    found = asked[verdict]
    if len(left) and len(found):
        from scipy.spatial import cKDTree

        _, nearest = cKDTree(of.samples.points[asked]).query(of.samples.points[left])
        found = np.concatenate([found, left[verdict[nearest]]])
    return _Inner(points[verdict], votes[verdict], found)


def _boxes_meet(of: Solid, within: Solid, T_within_of: SE3) -> bool:
    """Whether the bounding boxes overlap along the axes of the second solid."""
    middle = T_within_of @ ((of.low + of.high) / 2)
    reach = np.abs(T_within_of.R) @ ((of.high - of.low) / 2)
    return bool(((middle - reach < within.high) & (middle + reach > within.low)).all())


def _in_box(
    samples: NDArray[np.float32], within: Solid, T: SE3, tolerance_m: float
) -> NDArray[np.int64]:
    """Indices of the samples inside the bounding box of another solid."""
    chosen = np.arange(len(samples))
    p = samples
    for axis in range(3):
        row = T.R[axis].astype(np.float32)
        value = p[:, 0] * row[0] + p[:, 1] * row[1] + p[:, 2] * row[2] + np.float32(T.t[axis])
        low, high = within.low[axis] + tolerance_m, within.high[axis] - tolerance_m
        between = np.flatnonzero((value > low) & (value < high))
        chosen, p = chosen[between], p[between]
        if len(chosen) == 0:
            break
    return chosen


def _deepest(solid: Solid, points: Array) -> float:
    """Largest distance of inner points (N, 3) from the surface.

    The exact distance is expensive. The distance along rays is an upper bound: points are measured
    in descending order of their bounds until no bound exceeds the largest distance.
    """
    if len(points) == 0:
        return 0.0
    bound = solid.shortest_ray(points)
    order = np.argsort(-bound)[:_MOST_MEASURED]
    deepest = 0.0
    for part in np.array_split(order, max(1, len(order) // 16)):
        if bound[part[0]] <= deepest:
            break
        deepest = max(deepest, float(solid.nearest(points[part])[1].max()))
    return deepest


def _surface(obj: PlacedObject, inside: NDArray[np.int64]) -> Surface:
    samples: Samples = obj.solid.samples
    vertices = samples.vertex[inside]
    vertices = np.sort(vertices[vertices >= 0])
    marked = np.zeros(len(obj.solid.mesh.vertices), dtype=bool)
    marked[vertices] = True
    touched = obj.solid.faces_with(marked)
    touched[samples.face[inside]] = True
    points = obj.T_frame_obj @ (samples.points[inside] + obj.solid.centre)
    return Surface(vertices, np.flatnonzero(touched), points)


def _in_table(obj: PlacedObject, plane: Plane, tolerance_m: float) -> Penetration | None:
    # In the mesh frame, because rotating the normal is cheaper than rotating all vertices.
    local = plane.moved(_centred(obj).inverse(), "mesh")
    mesh = obj.solid.mesh
    lowest = float(local.signed_distance(obj.solid.hull - obj.solid.centre).min())
    if lowest >= -tolerance_m:
        return None
    below = local.signed_distance(mesh.vertices) < -tolerance_m
    used = np.zeros(len(mesh.vertices), dtype=bool)
    faces = np.flatnonzero(obj.solid.faces_with(below))
    used[mesh.faces[faces].reshape(-1)] = True
    vertices = np.flatnonzero(below & used)
    points = _centred(obj) @ mesh.vertices[vertices]
    nothing = Surface(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)))
    return Penetration(
        obj.name,
        TABLE,
        -lowest,
        Surface(vertices, faces, points),
        nothing,
        1.0,
        lambda: -lowest * plane.normal,
    )


def _centred(obj: PlacedObject) -> SE3:
    """Pose of the centred mesh."""
    T = obj.T_frame_obj
    return SE3(T.R, T.R @ obj.solid.centre + T.t)


def separate(
    a: Solid,
    b: Solid,
    T_b_a: SE3,
    points_a: Array,
    points_b: Array,
    *,
    up: Array | None = None,
) -> Array:
    """Return a translation (3,) of solid a, in the centred frame of b, that moves it out of b.

    Tries several directions. Along each, the translation must move all points out of the other
    solid, including points that enter it on the way. Returns the shortest one. Separating the
    convex hulls is an upper bound, and the result for hooked or nested solids.

    Args:
        a, b: the solids.
        T_b_a: transform between their centred frames.
        points_a: (N, 3) points on the surface of a inside b, centred frame of b.
        points_b: (M, 3) points on the surface of b inside a, centred frame of a.
        up: (3,) normal of the table, centred frame of b; a must not move against it.
    """
    inner_a, inner_b = points_a[:_ASKED], points_b[:_ASKED]
    directions = _directions(b, T_b_a, inner_a)
    if up is not None:
        directions = directions[directions @ up > -0.02]
    hull_a, hull_b = T_b_a @ (a.hull - a.centre), b.hull - b.centre
    apart = (hull_b @ directions.T).max(axis=0) - (hull_a @ directions.T).min(axis=0)
    best = int(apart.argmin())
    length, direction = float(apart[best]), directions[best]
    ways = np.array([_way(a, b, T_b_a, inner_a, inner_b, d) for d in directions])
    for i in np.argsort(ways)[:_TRIED]:
        way = _followed(a, b, T_b_a, directions[i], float(ways[i]), length)
        if way < length:
            length, direction = way, directions[i]
    return (length + _CLEARANCE_M) * direction


def _followed(a: Solid, b: Solid, T_b_a: SE3, d: Array, way: float, limit: float) -> float:
    """Distance along d at which the solids are separate; inf beyond the limit."""
    while way < limit:
        moved = SE3(T_b_a.R, T_b_a.t + (way + _CLEARANCE_M) * d)
        still_a = _still_inside(a, b, moved)
        still_b = _still_inside(b, a, moved.inverse())
        if len(still_a) + len(still_b) == 0:
            return way
        way += max(_way(a, b, moved, still_a, still_b, d), _CLEARANCE_M)
    return np.inf


def _directions(b: Solid, T_b_a: SE3, inner_a: Array) -> Array:
    """(K, 3) unit directions to try: to the nearest surface, axes of the meshes, all around."""
    axes = np.vstack([np.eye(3), T_b_a.R.T])
    apart = T_b_a.t / max(float(np.linalg.norm(T_b_a.t)), 1e-9)
    tried = [*axes, *-axes, apart, *sphere_directions(_DIRECTIONS)]
    if len(inner_a):
        surface, distance = b.nearest(inner_a[:50])
        outward = surface - inner_a[:50]
        # The mean is weighted by depth; the direction of the deepest point suits flat faces.
        tried += [outward.sum(axis=0), outward[int(distance.argmax())]]
    directions = np.array(tried)
    length = np.linalg.norm(directions, axis=1)
    return directions[length > 1e-9] / length[length > 1e-9, None]


def _way(a: Solid, b: Solid, T_b_a: SE3, inner_a: Array, inner_b: Array, d: Array) -> float:
    """Distance that a must move along d until these points are outside the other solid."""
    way = 0.0
    if len(inner_a):
        way = float(b.exit_distance(inner_a, d).max())
    if len(inner_b):
        # b's points leave a in the opposite direction.
        way = max(way, float(a.exit_distance(inner_b, -T_b_a.R.T @ d).max()))
    return way


def _still_inside(of: Solid, within: Solid, T_within_of: SE3) -> Array:
    """(N, 3) samples of one solid inside another, in the centred frame of the other one."""
    points = T_within_of @ of.samples.points[:8000].astype(np.float64)
    boxed = points[((points > within.low) & (points < within.high)).all(axis=1)][:_ASKED]
    return boxed[within.inside(boxed)[0]]
