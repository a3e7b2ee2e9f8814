"""The shortest way found to pull two solids apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support.solid import Solid, sphere_directions

Array = NDArray[np.float64]
# Directions are compared by so many points each.
_ASKED = 200
_DIRECTIONS = 24
# The most promising directions are followed to their end.
_TRIED = 5
# Beyond the surface by this much, so that the next look finds them apart.
_CLEARANCE_M = 0.0001


def separate(
    a: Solid,
    b: Solid,
    T_b_a: SE3,
    points_a: Array,
    points_b: Array,
    *,
    up: Array | None = None,
) -> Array:
    """Translation (3,) of solid a, in b's centred frame, after which it lies outside b.

    Along each of several directions the points inside the other solid need some way to come out,
    and with them the points that run into it on the way; the direction that needs least is taken.
    Pulling the convex hulls apart bounds the way: for hooked or nested solids it is the answer.

    Args:
        a, b: the solids.
        T_b_a: between their centred frames.
        points_a: (N, 3) points of a's surface inside b, b's centred frame.
        points_b: (M, 3) points of b's surface inside a, a's centred frame.
        up: (3,) direction against which a must not go, b's centred frame: the table's normal.
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
    """Length of the way along d after which nothing is inside any more; inf beyond the limit."""
    while way < limit:
        moved = SE3(T_b_a.R, T_b_a.t + (way + _CLEARANCE_M) * d)
        still_a = _still_inside(a, b, moved)
        still_b = _still_inside(b, a, moved.inverse())
        if len(still_a) + len(still_b) == 0:
            return way
        way += max(_way(a, b, moved, still_a, still_b, d), _CLEARANCE_M)
    return np.inf


def _directions(b: Solid, T_b_a: SE3, inner_a: Array) -> Array:
    """(K, 3) unit directions worth trying: to the nearest surface, the meshes' axes, all around."""
    axes = np.vstack([np.eye(3), T_b_a.R.T])
    apart = T_b_a.t / max(float(np.linalg.norm(T_b_a.t)), 1e-9)
    tried = [*axes, *-axes, apart, *sphere_directions(_DIRECTIONS)]
    if len(inner_a):
        surface, distance = b.nearest(inner_a[:50])
        outward = surface - inner_a[:50]
        # The mean is weighted by depth; the deepest point's own direction is that of flat faces.
        tried += [outward.sum(axis=0), outward[int(distance.argmax())]]
    directions = np.array(tried)
    length = np.linalg.norm(directions, axis=1)
    return directions[length > 1e-9] / length[length > 1e-9, None]


def _way(a: Solid, b: Solid, T_b_a: SE3, inner_a: Array, inner_b: Array, d: Array) -> float:
    """How far a must go along d until these points have left the other solid."""
    way = 0.0
    if len(inner_a):
        way = float(b.exit_distance(inner_a, d).max())
    if len(inner_b):
        # b's points leave a in the opposite direction.
        way = max(way, float(a.exit_distance(inner_b, -T_b_a.R.T @ d).max()))
    return way


def _still_inside(of: Solid, within: Solid, T_within_of: SE3) -> Array:
    """(N, 3) some samples of one solid inside another, in the other's centred frame."""
    points = T_within_of @ of.samples.points[:8000].astype(np.float64)
    boxed = points[((points > within.low) & (points < within.high)).all(axis=1)][:_ASKED]
    return boxed[within.inside(boxed)[0]]
