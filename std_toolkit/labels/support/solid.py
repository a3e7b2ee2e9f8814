"""Meshes as solids: hull, inside test, surface samples. Computed once per mesh and cached."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support.resting import RestingFaces, resting_faces, sphere_directions
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh
from std_toolkit.settings import NOT_RECORDED, Settings, limit

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
# Approximate distance between samples, within the limits of their number.
_SPACING_M = 0.0015
_FEWEST_SAMPLES, _MOST_SAMPLES = 2000, 16000
_FEW_VERTICES = 500
# Odd numbers of rays, in directions that are not axes of typical meshes.
_RAYS, _FIRST_RAYS = 11, 3
_MOST_HULL_FACETS = 1400
_KEPT = 64


@dataclass(frozen=True, kw_only=True)
class SolidSettings(Settings):
    """When a mesh encloses a volume."""

    votes_if_open: float = limit(0.8, source=NOT_RECORDED)
    """fraction of the rays that must report that a point is inside a mesh with gaps"""
    opening: float = limit(0.35, source=NOT_RECORDED)
    """a mesh with a gap larger than this fraction of its diagonal is a sheet"""


@dataclass(frozen=True, eq=False)
class Samples:
    """Points on a surface in random order, so that the first n of them cover it evenly.

    Attributes:
        points: (N, 3) float32, centred mesh coordinates.
        vertex: (N,) index of the vertex, -1 for a point inside a face.
        face: (N,) index of a face that holds the point.
    """

    points: NDArray[np.float32]
    vertex: NDArray[np.int64]
    face: NDArray[np.int64]


class Solid:
    """A mesh with derived data for contact and support; centred coordinates are `p - centre`.

    Args:
        mesh: prepared mesh.
    """

    def __init__(self, mesh: RenderMesh) -> None:
        self.mesh = mesh
        self.centre = mesh.centre
        used = mesh.vertices[np.unique(mesh.faces)]
        self.low, self.high = used.min(axis=0), used.max(axis=0)
        self._lock = threading.Lock()

    @cached_property
    def hull(self) -> Array:
        """(H, 3) vertices of the convex hull, mesh frame, metres."""
        return self._hull[0] + self.centre

    @cached_property
    def facets(self) -> NDArray[np.int64]:
        """(K, 3) triangles of the convex hull, indices into `hull`; none if the mesh is flat."""
        return self._hull[1]

    @cached_property
    def _hull(self) -> tuple[Array, NDArray[np.int64]]:
        from scipy.spatial import ConvexHull, QhullError

        used = self.mesh.vertices[np.unique(self.mesh.faces)]
        if np.linalg.matrix_rank(used - used.mean(axis=0), tol=1e-9 * self.mesh.diagonal) < 3:
            return used, np.zeros((0, 3), dtype=np.int64)
        try:
            hull = ConvexHull(used)
        except QhullError:
            return used, np.zeros((0, 3), dtype=np.int64)
        order = np.full(len(used), -1)
        order[hull.vertices] = np.arange(len(hull.vertices))
        return used[hull.vertices], order[hull.simplices].astype(np.int64)

    @cached_property
    def coarse_hull(self) -> tuple[Array, NDArray[np.int64]]:
        """`hull` and `facets`, reduced to few facets; a ball would have very many."""
        if len(self.facets) <= _MOST_HULL_FACETS:
            return self.hull, self.facets
        from scipy.spatial import ConvexHull

        extreme = np.unique(
            (self.hull @ sphere_directions(_MOST_HULL_FACETS // 2).T).argmax(axis=0)
        )
        hull = ConvexHull(self.hull[extreme])
        order = np.full(len(extreme), -1)
        order[hull.vertices] = np.arange(len(hull.vertices))
        return self.hull[extreme][hull.vertices], order[hull.simplices].astype(np.int64)

    @property
    def closed(self) -> bool:
        """Whether the surface has no border. Vertices split by texture seams count as one."""
        return self.gap_m == 0

    @property
    def sheet(self) -> bool:
        """Whether the mesh is too open to have an inside, such as a cup one triangle thick."""
        return self.gap_m > SolidSettings.current().opening * self.mesh.diagonal

    @cached_property
    def gap_m(self) -> float:
        """Bounding-box diagonal of the largest gap in the surface, metres; 0 if closed."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        places, welded = np.unique(self.mesh.vertices, axis=0, return_inverse=True)
        corners = welded.reshape(-1)[self.mesh.faces].astype(np.int64)
        edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges = edges[edges[:, 0] != edges[:, 1]]
        keys, counts = np.unique(edges[:, 0] * len(places) + edges[:, 1], return_counts=True)
        i, j = np.divmod(keys[counts == 1], len(places))
        if len(i) == 0:
            return 0.0
        graph = coo_array((np.ones(len(i)), (i, j)), shape=(len(places), len(places)))
        _, border = connected_components(graph, directed=False)
        return max(
            float(np.linalg.norm(np.ptp(places[np.union1d(i[mine], j[mine])], axis=0)))
            for k in np.unique(border[i])
            if (mine := border[i] == k).any()
        )

    @cached_property
    def centre_of_mass(self) -> Array:
        """(3,) mesh frame, metres, for uniform density; that of the hull if the mesh is open."""
        import trimesh

        if self.mesh.closed:
            return _centroid(self.mesh.vertices, self.mesh.faces) + self.centre
        vertices, facets = self._hull
        if len(facets) == 0:
            return vertices.mean(axis=0) + self.centre
        body = trimesh.Trimesh(vertices, facets, process=False)
        body.fix_normals()
        return _centroid(body.vertices, body.faces) + self.centre

    @cached_property
    def resting(self) -> RestingFaces:
        """Resting directions on a plane."""
        return resting_faces(*self.coarse_hull, self.centre_of_mass)

    @cached_property
    def samples(self) -> Samples:
        """All vertices (a subset for a very fine mesh) and points spread over the faces."""
        rng = np.random.default_rng(0)
        v, faces = self.mesh.vertices, self.mesh.faces
        a, b, c = (v[faces[:, i]] for i in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        face_of = np.zeros(len(v), dtype=np.int64)
        face_of[faces.reshape(-1)] = np.repeat(np.arange(len(faces)), 3)
        vertices = np.unique(faces)
        if len(vertices) > _MOST_SAMPLES:
            vertices = rng.choice(vertices, _MOST_SAMPLES, replace=False)
        wanted = int(np.clip(area.sum() / _SPACING_M**2, _FEWEST_SAMPLES, _MOST_SAMPLES))
        count = max(wanted - len(vertices), 0) if area.sum() > 0 else 0
        chosen = rng.choice(len(faces), count, p=area / area.sum()) if count else np.zeros(0, int)
        u, w = rng.random((2, count))
        over = u + w > 1
        u[over], w[over] = 1 - u[over], 1 - w[over]
        inner = (
            a[chosen] + u[:, None] * (b[chosen] - a[chosen]) + w[:, None] * (c[chosen] - a[chosen])
        )
        points = np.concatenate([v[vertices], inner]).astype(np.float32)
        vertex = np.concatenate([vertices, np.full(count, -1)])
        face = np.concatenate([face_of[vertices], chosen])
        order = rng.permutation(len(points))
        if len(vertices) <= _FEW_VERTICES:
            # Vertices first, because the extreme points of a coarse mesh are its corners.
            order = np.concatenate([order[order < len(vertices)], order[order >= len(vertices)]])
        return Samples(points[order], vertex[order], face[order])

    @cached_property
    def caster(self) -> RayCaster:
        """Ray caster of the centred mesh."""
        caster = RayCaster(self.mesh.vertices, self.mesh.faces)
        # The first query builds the tree, which must not happen while another thread queries.
        caster.distance(np.zeros((1, 3)))
        return caster

    def prepare(self) -> None:
        """Compute the data that `inside` and the depth measurement need. Thread-safe."""
        with self._lock:
            _ = self.caster, self.gap_m, self.samples, self.hull, self._corners

    def inside(self, points: NDArray[np.floating]) -> tuple[NDArray[np.bool_], Array]:
        """Return whether points (N, 3), centred coordinates, are inside.

        Rays in several directions vote by the parity of their crossings. A point is inside a closed
        surface with a majority of the votes, and inside one with gaps with more than four fifths.
        A sheet has no inside.

        Returns:
            (N,) bool, and (N,) fraction of the rays that report inside.
        """
        if len(points) == 0 or self.sheet:
            return np.zeros(len(points), dtype=bool), np.zeros(len(points))
        directions = sphere_directions(_RAYS)
        first = self._odd(points, directions[:_FIRST_RAYS])
        votes = first / _FIRST_RAYS
        # For most points the first rays agree.
        clear = (first == 0) | (self.closed & (first == _FIRST_RAYS))
        rest = np.flatnonzero(~clear)
        if len(rest):
            votes[rest] = (first[rest] + self._odd(points[rest], directions[_FIRST_RAYS:])) / _RAYS
        return votes > (0.5 if self.closed else SolidSettings.current().votes_if_open), votes

    def _odd(self, points: NDArray[np.floating], directions: Array) -> NDArray[np.int64]:
        """(N,) number of rays from each point (N, 3) with an odd number of surface crossings."""
        rays = np.empty((len(directions), len(points), 6), np.float32)
        rays[..., :3] = points
        rays[..., 3:] = directions[:, None]
        return (self.caster.crossings(rays) & 1).sum(axis=0, dtype=np.int64)

    def faces_with(self, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (F,) which faces have a marked vertex (V,)."""
        a, b, c = self._corners
        return marked[a] | marked[b] | marked[c]

    @cached_property
    def _corners(self) -> tuple[NDArray[np.int32], ...]:
        return tuple(np.ascontiguousarray(self.mesh.faces[:, i]) for i in range(3))

    def nearest(self, points: NDArray[np.floating]) -> tuple[Array, Array]:
        """Return the nearest surface points (N, 3), centred coordinates, and distances (N,)."""
        query = np.ascontiguousarray(points, dtype=np.float32)
        surface = self.caster.closest(query)[0].astype(np.float64)
        x, y, z = (surface - query).T
        return surface, np.sqrt(x * x + y * y + z * z)

    def shortest_ray(self, points: NDArray[np.floating]) -> Array:
        """Return (N,) metres to the surface along the shortest ray: an upper bound of `nearest`."""
        directions = sphere_directions(_RAYS)[:_FIRST_RAYS]
        return np.min([self.exit_distance(points, d) for d in directions], axis=0)

    def exit_distance(self, points: NDArray[np.floating], direction: Array) -> Array:
        """Return (N,) metres from points (N, 3), centred, along a unit direction to the surface.

        inf if the ray does not hit the surface.
        """
        rays = np.empty((len(points), 6), np.float32)
        rays[:, :3], rays[:, 3:] = points, direction
        return self.caster.cast(rays).distance.astype(np.float64)


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """A mesh at a pose, such as a labelled object.

    Attributes:
        name: name for messages.
        mesh: mesh in metres.
        T_frame_obj: maps mesh coordinates into the common frame (the world, or one camera).
    """

    name: str
    mesh: trimesh.Trimesh | RenderMesh
    T_frame_obj: SE3

    @property
    def solid(self) -> Solid:
        """Derived data of the mesh (cached by content)."""
        return solid_of(self.mesh)


_kept: OrderedDict[int, Solid] = OrderedDict()
_kept_lock = threading.Lock()


def solid_of(mesh: trimesh.Trimesh | RenderMesh) -> Solid:
    """Return the solid of a mesh, from a cache keyed by its content."""
    prepared = prepare_mesh(mesh)
    with _kept_lock:
        found = _kept.get(id(prepared))
        if found is None:
            # The solid keeps its mesh alive, so that the id stays unique.
            found = _kept[id(prepared)] = Solid(prepared)
            while len(_kept) > _KEPT:
                _kept.popitem(last=False)
        else:
            _kept.move_to_end(id(prepared))
        return found


def _centroid(vertices: Array, faces: NDArray[Any]) -> Array:
    """Centroid of the volume that a closed surface encloses."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    return ((a + b + c) * volume[:, None]).sum(axis=0) / (4 * volume.sum())
