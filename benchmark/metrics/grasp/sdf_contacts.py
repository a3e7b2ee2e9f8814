"""Contacts as GraspNet's evaluation finds them: in a grid of signed distances.

Source: H.-S. Fang et al., CVPR 2020, and the published program graspnetAPI with dex-net (J. Mahler
et al., RSS 2017). The steps of the fingers, the threshold of the surface, the zero of a parabola
and normals fitted to 27 points at most are theirs, with the errors that they have: normals are
quantised, some contacts on flat faces are not found, and a finger that starts beyond the grid may
meet its border. Use these contacts to compare with
published figures; those of `force_closure.GraspedMesh` are exact.
"""

from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.grasp.force_closure import Contacts, friction_scores
from benchmark.metrics.grasp.grasp import Grasps
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

NODES = 100
# Number of cells across the longest side of the mesh.
_EXTENT_CELLS = 90
# Points nearer than this many cells are on the surface.
_ON_SURFACE = np.sqrt(2) / 2
# Steps of a finger in each cell of the opening.
_STEPS = 2
_NORMAL_RADIUS = 1.5
# A parabola flatter than this (metres per squared cell) has no zero; a zero farther than this
# (cells) from its first point is none.
_FLAT, _FARTHEST = 1e-10, 1.0
_LONGEST_ROOT = 10.0
_OUTSIDE_M = 1.0

_CORNERS = np.array(list(product((0, 1), repeat=3)))
_AROUND = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))


class SdfMesh:
    """A mesh as signed distances on 100 nodes along each axis.

    Args:
        vertices: (V, 3) metres, in the frame of the grasps.
        faces: (F, 3); they enclose a volume.

    Raises:
        ToolkitError: no faces.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        corners = np.asarray(vertices, dtype=np.float64)
        f = np.asarray(faces)
        if f.ndim != 2 or not len(f):
            raise ToolkitError("the mesh holds no faces", value=f.shape)
        used = corners[np.unique(f)]
        low, high = used.min(axis=0), used.max(axis=0)
        self.cell = float((high - low).max()) / _EXTENT_CELLS
        self.origin = (low + high) / 2 - NODES / 2 * self.cell
        self._triangles = corners[f]
        self._caster = RayCaster(corners, f, threads=1)
        # NaN: not computed yet.
        self._nodes = np.full(NODES**3, np.nan)

    def distances(self, cells: Floats) -> Floats:
        """Signed distances, interpolated.

        Args:
            cells: (N, 3) in cells from the first node.

        Returns:
            (N,) metres, negative inside; a metre beyond the grid.
        """
        within = ((cells >= 0) & (cells < NODES)).all(axis=1)
        found = np.full(len(cells), _OUTSIDE_M)
        if not within.any():
            return found
        inner = cells[within]
        base = np.floor(inner)
        nodes = base.astype(np.int64)[:, None] + _CORNERS
        weight = (1 - np.abs(nodes - inner[:, None])).prod(axis=2)
        # Nodes beyond the grid count as 0, as there.
        there = (nodes < NODES).all(axis=2)
        flat = np.where(there, (nodes * [NODES**2, NODES, 1]).sum(axis=2), 0)
        self._compute(np.unique(flat))
        found[within] = (np.where(there, self._nodes[flat], 0.0) * weight).sum(axis=1)
        return found

    def contacts(self, grasps: Grasps) -> Contacts:
        """Close the fingers of grasps in the frame of the mesh; see `GraspedMesh.contacts`."""
        count = len(grasps)
        points, normals = np.zeros((count, 2, 3)), np.zeros((count, 2, 3))
        found = np.zeros(count, dtype=bool)
        for n in range(count):
            both = []
            for side in (1.0, -1.0):
                axis = side * grasps.closings[n] / np.linalg.norm(grasps.closings[n])
                both.append(self._contact(grasps.tips[n], axis, float(grasps.widths[n])))
            if both[0] is not None and both[1] is not None:
                found[n] = True
                points[n] = both[0][0], both[1][0]
                normals[n] = both[0][1], both[1][1]
        return Contacts(found, points, normals)

    def friction_scores(self, grasps: Grasps) -> Floats:
        """(N,) smallest friction of 0.2, 0.4, ... 1.2 at which each grasp holds, -1 if none."""
        return friction_scores(self.contacts(grasps))

    def _contact(self, middle: Floats, axis: Floats, width: float) -> tuple[Floats, Floats] | None:
        """Point and normal where a finger that moves to the middle meets the surface."""
        steps = max(int(_STEPS * width / self.cell / 2), 3)
        way = np.linspace(0, width / 2, steps)
        line = self._cells(middle - width / 2 * axis + way[:, None] * axis)
        values = self.distances(line)
        for i in np.flatnonzero(np.abs(values) < _ON_SURFACE * self.cell):
            first = min(max(int(i) - 1, 0), steps - 3)
            three = slice(first, first + 3)
            if i < steps - 1 and abs(values[i + 1]) < abs(values[i]):
                continue
            zero = _zero(line[three], values[three])
            if zero is None:
                continue
            point = self.origin + self.cell * zero.astype(np.float32)
            normal = self._normal(self._cells(point[None])[0])
            return None if normal is None else (point, normal)
        return None

    def _normal(self, cell: Floats) -> Floats | None:
        """Normal of the plane through the points around a place that are on the surface."""
        around = _AROUND / np.maximum(np.linalg.norm(_AROUND, axis=1, keepdims=True), 1)
        near = cell + _NORMAL_RADIUS * around
        on = np.abs(self.distances(near)) < _ON_SURFACE * self.cell
        if not on[len(on) // 2]:  # the place itself
            return None
        spread = near[on] - near[on].mean(axis=0)
        return np.asarray(np.linalg.svd(spread.T)[0][:, 2])

    def _cells(self, points: Floats) -> Floats:
        """Points (N, 3) in cells; they pass through float32, as there."""
        return (points.astype(np.float32).astype(np.float64) - self.origin) / self.cell

    def _compute(self, flat: Ids) -> None:
        missing = flat[np.isnan(self._nodes[flat])]
        if not len(missing):
            return
        index = np.stack(np.unravel_index(missing, (NODES,) * 3), axis=1)
        points = self.origin + self.cell * index
        face, _ = self._caster.closest_faces(points)
        # The ray caster has the right face, in single precision.
        apart = _triangle_distances(points, self._triangles[face])
        self._nodes[missing] = np.where(self._caster.inside(points), -apart, apart)


def _zero(places: Floats, values: Floats) -> Floats | None:
    """Where the parabola through three points of a line crosses 0; None where it does not."""
    step = places[1] - places[0]
    direction = step / np.linalg.norm(step)
    axis = int(np.flatnonzero(direction)[0])
    t = (places[:, axis] - places[0, axis]) / direction[axis]
    a, b, c = np.linalg.solve(np.stack([t**2, t, np.ones(3)], axis=1), values)
    if abs(a) < _FLAT:
        return None
    root = -b / (2 * a)
    for each in np.roots([a, b, c]):
        if not np.iscomplex(each) and 0 <= each.real <= _LONGEST_ROOT:
            root = float(each.real)
    return places[0] + root * direction if abs(root) <= _FARTHEST else None


def _triangle_distances(points: Floats, triangles: Floats) -> Floats:
    """(N,) distances of points (N, 3) from triangles (N, 3, 3)."""
    a = triangles[:, 0]
    ab, ac, ap = triangles[:, 1] - a, triangles[:, 2] - a, points - a
    normal = np.cross(ab, ac)
    size = np.einsum("ni,ni->n", normal, normal)
    safe = np.maximum(size, 1e-300)
    v = np.einsum("ni,ni->n", np.cross(ap, ac), normal) / safe
    w = np.einsum("ni,ni->n", np.cross(ab, ap), normal) / safe
    over = (size > 0) & (v >= 0) & (w >= 0) & (v + w <= 1)
    plane = np.abs(np.einsum("ni,ni->n", ap, normal)) / np.sqrt(safe)
    edges = np.full(len(points), np.inf)
    for k in range(3):
        start, edge = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        length = np.maximum(np.einsum("ni,ni->n", edge, edge), 1e-300)
        s = np.clip(np.einsum("ni,ni->n", points - start, edge) / length, 0, 1)
        edges = np.minimum(edges, np.linalg.norm(points - start - s[:, None] * edge, axis=1))
    return np.where(over, plane, edges)
