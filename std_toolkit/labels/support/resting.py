"""Stable resting poses of an object on a plane, as directions in its mesh frame that point down.

An object rests on a facet of its convex hull if its centre of mass projects into the facet. Scans
are not exactly flat: vertices within a small tolerance of the plane of a facet count as contacts,
and facets that differ by a few degrees count as one. A round body also rests on the edges between
narrow facets, because rolling hardly raises its centre of mass. This keeps the roll of a label.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]
# Lower limit of the distance of a contact from the plane.
_CONTACT_FLOOR_M = 0.0001
# An object is a ball if the height of its centre stays constant when tipped by this angle.
_BALL_TIP = np.radians(4.0)


@dataclass(frozen=True, kw_only=True)
class RestingSettings(Settings):
    """Which resting poses of an object are stable."""

    contact: float = limit(0.002, source=NOT_RECORDED)
    """largest distance of a contact from the plane, relative to the size of the object"""
    rolling: float = limit(0.001, source=NOT_RECORDED)
    """rolling over an edge may raise the centre of mass by this fraction of the size"""
    steady: float = limit(np.radians(2.5), unit="rad", source=NOT_RECORDED)
    """a facet is stable if the object does not topple when tipped by this angle"""
    ball: float = limit(0.003, source=NOT_RECORDED)
    """an object is a ball if the height of its centre changes by less than this fraction of the
    size when tipped"""
    same_facet: float = limit(np.radians(5.0), unit="rad", source=NOT_RECORDED)
    """facets whose directions differ by less are one"""
    rolling_reach: float = limit(np.radians(15.0), unit="rad", source=NOT_RECORDED)
    """facets further apart are not joined by rolling"""


@dataclass(frozen=True, eq=False)
class RestingFaces:
    """Directions (unit, mesh frame) that point down when the object rests.

    Attributes:
        down: (K, 3) direction per facet.
        steady: (K,) angle to which the object can be tipped before it topples, radians.
        rolling: (E, 2) pairs of facets between which it rolls.
    """

    down: Array
    steady: Array
    rolling: NDArray[np.int64]
    _hull: Array
    _size: float

    def nearest(self, down: Array) -> tuple[Array, float]:
        """Return the resting direction nearest to a unit direction (3,), and the angle in radians.

        A ball rests in every direction.
        """
        if self._is_ball(down):
            return down, 0.0
        best = self.down[int((self.down @ down).argmax())]
        for i, j in self.rolling:
            on_arc = _nearest_on_arc(down, self.down[i], self.down[j])
            if on_arc is not None and on_arc @ down > best @ down:
                best = on_arc
        return best, _angle(best, down)

    def _is_ball(self, down: Array) -> bool:
        side = np.cross(down, np.eye(3)[int(np.abs(down).argmin())])
        side /= np.linalg.norm(side)
        other = np.cross(down, side)
        turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other
        ring = np.cos(_BALL_TIP) * down + np.sin(_BALL_TIP) * around
        heights = _heights(self._hull, np.vstack([down, ring]))
        return bool(np.ptp(heights) < RestingSettings.current().ball * self._size)


# Directions in a plane, as columns.
_TURN = np.linspace(0, 2 * np.pi, 72, endpoint=False)
_AROUND = np.stack([np.cos(_TURN), np.sin(_TURN)])


def resting_faces(hull: Array, facets: NDArray[np.int64], centre_of_mass: Array) -> RestingFaces:
    """Compute the resting directions of an object; at least one for any mesh.

    Args:
        hull: (H, 3) vertices of the convex hull, mesh frame, metres.
        facets: (K, 3) triangles of the hull; none if the mesh is flat.
        centre_of_mass: (3,) mesh frame, metres.
    """
    limits = RestingSettings.current()
    hull = hull - centre_of_mass
    size = float(np.linalg.norm(np.ptp(hull, axis=0)))
    if len(facets) == 0:
        normal = np.linalg.svd(hull - hull.mean(axis=0), full_matrices=False)[2][-1]
        none = np.zeros((0, 2), dtype=np.int64)
        return RestingFaces(np.stack([normal, -normal]), np.full(2, np.pi / 2), none, hull, size)
    if np.ptp(_heights(hull, sphere_directions(500))) < limits.ball * size:
        axes, none = np.vstack([np.eye(3), -np.eye(3)]), np.zeros((0, 2), dtype=np.int64)
        return RestingFaces(axes, np.full(6, limits.steady), none, hull, size)
    down, steady = _stable(hull, facets, max(limits.contact * size, _CONTACT_FLOOR_M))
    down, steady = _merged(down, steady, _heights(hull, down))
    rolling = _rolling(hull, down, limits.rolling * size)
    rolls = np.zeros(len(down), dtype=bool)
    rolls[rolling.reshape(-1)] = True
    keep = (steady >= limits.steady) | rolls
    if not keep.any():
        keep[int(steady.argmax())] = True
    number = np.cumsum(keep) - 1
    rolling = rolling[keep[rolling].all(axis=1)] if len(rolling) else rolling
    return RestingFaces(down[keep], steady[keep], number[rolling], hull, size)


def _stable(hull: Array, facets: NDArray[np.int64], contact_m: float) -> tuple[Array, Array]:
    """Outward normals of the facets into which the origin projects, and their tipping angles."""
    a, b, c = (hull[facets[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    double_area = np.linalg.norm(normals, axis=1)
    good = double_area > 1e-14
    normals = normals[good] / double_area[good, None]
    height = np.einsum("ij,ij->i", normals, a[good])
    # The origin is inside the hull, so an outward normal points to the side of its facet.
    normals[height < 0] *= -1
    # Axes of the plane of each facet.
    side = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    planes = np.stack([side, np.cross(normals, side)], axis=-1)
    down, steady = [], []
    for normal, plane in zip(normals, planes, strict=True):
        along = hull @ normal
        contacts = hull[along > along.max() - contact_m]
        tip = _tipping(contacts @ plane, float(along.max()))
        if tip > 0:
            down.append(_facet_normal(contacts, normal))
            steady.append(tip)
    if not down:
        # Due to rounding. The facet with the lowest centre of mass is always stable.
        lowest = normals[int(_heights(hull, normals).argmin())]
        return lowest[None], np.zeros(1)
    return np.array(down), np.array(steady)


def _tipping(plane: Array, height: float) -> float:
    """Angle at the centre of mass to the nearest edge of the contact polygon; 0 outside.

    Args:
        plane: (N, 2) contacts in their plane, about the foot of the centre of mass.
        height: of the centre of mass above the plane.
    """
    if len(plane) < 3:
        return 0.0
    angle = np.sort(np.arctan2(plane[:, 1], plane[:, 0]))
    if max(float((angle[1:] - angle[:-1]).max()), angle[0] + 2 * np.pi - angle[-1]) >= np.pi:
        return 0.0
    # The distance of the nearest edge is the smallest extent of the polygon over all directions.
    reach = (plane @ _AROUND).max(axis=0).min()
    return float(np.arctan2(reach, max(height, 1e-9)))


def _facet_normal(contacts: Array, normal: Array) -> Array:
    """Normal of the plane fitted to the contacts; `normal` if they are exactly in its plane."""
    limits = RestingSettings.current()
    centred = contacts - contacts.mean(axis=0)
    if np.abs(centred @ normal).max() < 1e-7:
        return normal
    scatter, axes = np.linalg.eigh(centred.T @ centred)
    fitted = axes[:, 0] if axes[:, 0] @ normal >= 0 else -axes[:, 0]
    # A narrow strip of contacts does not determine the rotation about its axis.
    narrow = scatter[1] < 0.01 * scatter[2]
    return normal if narrow or _angle(fitted, normal) > limits.same_facet else fitted


def _merged(down: Array, steady: Array, heights: Array) -> tuple[Array, Array]:
    """Merge facets that differ by a few degrees into the one with the lowest centre of mass."""
    limits = RestingSettings.current()
    left = list(np.argsort(heights, kind="stable"))
    kept, best = [], []
    while left:
        first = left[0]
        near = [i for i in left if _angle(down[i], down[first]) < limits.same_facet]
        kept.append(first)
        best.append(max(steady[i] for i in near))
        left = [i for i in left if i not in near]
    return down[kept], np.array(best)


def _rolling(hull: Array, down: Array, tolerance_m: float) -> NDArray[np.int64]:
    """Pairs of directions between which the height of the centre of mass stays constant."""
    i, j = np.triu_indices(len(down), 1)
    near = np.einsum("ij,ij->i", down[i], down[j]) > np.cos(RestingSettings.current().rolling_reach)
    i, j = i[near], j[near]
    if len(i) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    s = np.linspace(0, 1, 7)[:, None, None]
    way = (1 - s) * down[i] + s * down[j]
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    heights = _heights(hull, way.reshape(-1, 3)).reshape(len(s), -1)
    flat = np.ptp(heights, axis=0) < tolerance_m
    return np.stack([i[flat], j[flat]], axis=1)


def _heights(hull: Array, down: Array) -> Array:
    """(N,) height of the origin above a plane that touches the hull in directions (N, 3)."""
    parts = np.array_split(down, max(1, len(down) * len(hull) // 4_000_000))
    return np.concatenate([(hull @ part.T).max(axis=0) for part in parts])


def _nearest_on_arc(direction: Array, a: Array, b: Array) -> Array | None:
    """Point on the arc from a to b nearest to a direction; None if it is an end."""
    pole = np.cross(a, b)
    pole /= np.linalg.norm(pole)
    foot = direction - (direction @ pole) * pole
    length = float(np.linalg.norm(foot))
    if length < 1e-9:
        return None
    foot /= length
    between = np.cross(a, foot) @ pole > 0 and np.cross(foot, b) @ pole > 0
    return foot if between else None


def _angle(a: Array, b: Array) -> float:
    """Angle between unit vectors in radians, accurate for small angles too."""
    return float(2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))


def sphere_directions(count: int) -> Array:
    """Return (N, 3) unit vectors spread evenly over the sphere (golden-angle spiral)."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    turn = np.pi * (1 + 5**0.5) * i + 0.3
    r = np.sqrt(1 - z**2)
    # Tilted, because the pole of the spiral would coincide with an axis of many meshes.
    tilt = np.array([[0.8, 0.0, 0.6], [0.36, 0.8, -0.48], [-0.48, 0.6, 0.64]])
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1) @ tilt.T
