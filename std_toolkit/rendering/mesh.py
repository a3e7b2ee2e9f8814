"""Meshes prepared for rendering: centred vertices, hull, bounding box and corner normals.

`prepare_mesh` caches the most recent meshes by content: a call per frame is only a look-up, and a
mesh that was changed in place is prepared again.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    import trimesh

CREASE_DEG = 40.0
"""Faces that meet at a larger angle keep their own normals, so that edges stay sharp."""

_CACHE_SIZE = 64
_cache: OrderedDict[tuple[int, int], RenderMesh] = OrderedDict()
_cache_lock = threading.Lock()


@dataclass(frozen=True, eq=False)
class RenderMesh:
    """A triangle mesh prepared for renderers.

    Attributes:
        vertices: (V,3) float64, metres, relative to `centre` to keep float32 precision.
        faces: (F,3) int32.
        centre: (3,) float64, centre of the bounding box in mesh coordinates.
        diagonal: length of the bounding-box diagonal in metres (the NOCS scale).
    """

    vertices: np.ndarray
    faces: np.ndarray
    centre: np.ndarray
    diagonal: float

    @classmethod
    def from_arrays(cls, vertices: np.ndarray, faces: np.ndarray) -> RenderMesh:
        """Build from (V,3) vertices in metres and (F,3) vertex indices.

        Raises:
            ToolkitError: the mesh is empty, a number is not finite, or an index is out of range.
        """
        points = np.asarray(vertices, np.float64).reshape(-1, 3)
        triangles = np.ascontiguousarray(faces, np.int32).reshape(-1, 3)
        if len(points) == 0 or len(triangles) == 0:
            raise ToolkitError(
                "a mesh without faces cannot be rendered",
                field="faces",
                value=len(triangles),
                hint="export the model as a triangle mesh, not as a point cloud",
            )
        if not np.isfinite(points).all():
            raise ToolkitError("mesh has vertices that are not finite", field="vertices")
        if triangles.min() < 0 or triangles.max() >= len(points):
            raise ToolkitError(
                "mesh face refers to a vertex that does not exist",
                field="faces",
                value=int(triangles.max()),
            )
        used = points[np.unique(triangles)]
        low, high = used.min(axis=0), used.max(axis=0)
        centre = (low + high) / 2
        return cls(points - centre, triangles, centre, float(np.linalg.norm(high - low)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the geometry, which identifies the mesh in provenance records."""
        h = hashlib.sha256()
        for part in (self.vertices, self.centre, self.faces.astype("<i4")):
            h.update(np.ascontiguousarray(part).tobytes())
        return h.hexdigest()

    @cached_property
    def hull(self) -> np.ndarray:
        """(K,3) float64 centred points whose projection has the same bounding box as the mesh."""
        from scipy.spatial import ConvexHull, QhullError

        try:
            return self.vertices[ConvexHull(self.vertices).vertices]
        except (QhullError, ValueError):  # a flat mesh has no 3D hull
            return self.vertices[np.unique(self.faces)]

    @cached_property
    def closed(self) -> bool:
        """Whether every ray from outside hits a front face first (watertight, outward winding)."""
        import trimesh

        _, merged = np.unique(self.vertices, axis=0, return_inverse=True)
        solid = trimesh.Trimesh(
            vertices=self.vertices, faces=self.faces, process=False, validate=False
        )
        welded = trimesh.Trimesh(
            vertices=np.zeros((int(merged.max()) + 1, 3)),
            faces=merged.reshape(-1)[self.faces],
            process=False,
            validate=False,
        )
        return bool(welded.is_watertight and welded.is_winding_consistent and solid.volume > 0)

    @cached_property
    def face_normals(self) -> np.ndarray:
        """(F,3) float32 unit normals by the right-hand rule; zero for faces of no area."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return _unit(np.cross(b - a, c - a)).astype(np.float32)

    @cached_property
    def corner_normals(self) -> np.ndarray:
        """(F,3,3) float32 smooth normals of the three corners of every face.

        The angle-weighted mean over the faces around the corner whose normals are within
        `CREASE_DEG` of the face's own. Vertices at the same position count as one, so texture
        seams, which split vertices, do not affect the normals.
        """
        _, welded = np.unique(self.vertices, axis=0, return_inverse=True)
        corner_vertex = welded.reshape(-1)[self.faces].reshape(-1)
        corner_face = np.repeat(np.arange(len(self.faces)), 3)
        normals = self.face_normals.astype(np.float64)
        weight = _corner_angles(self.vertices[self.faces]).reshape(-1)

        order = np.argsort(corner_vertex, kind="stable")
        counts = np.bincount(corner_vertex)
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        # Every ordered pair of corners at one vertex; a fan of d faces gives d * d pairs.
        degree = counts[corner_vertex]
        target = np.repeat(np.arange(len(corner_vertex)), degree)
        start = np.repeat(first[corner_vertex], degree)
        offset = np.arange(len(target)) - np.repeat(np.cumsum(degree) - degree, degree)
        source = order[start + offset]
        n_source = normals[corner_face[source]]
        agree = np.einsum("ij,ij->i", normals[corner_face[target]], n_source)
        w = np.where(agree >= np.cos(np.deg2rad(CREASE_DEG)), weight[source], 0.0)
        total = np.stack(
            [
                np.bincount(target, weights=w * n_source[:, i], minlength=len(corner_vertex))
                for i in range(3)
            ],
            axis=1,
        )
        smooth = _unit(total)
        flat = np.linalg.norm(smooth, axis=1) < 0.5
        smooth[flat] = normals[corner_face[flat]]
        return smooth.reshape(-1, 3, 3).astype(np.float32)

    @cached_property
    def interpolation(self) -> np.ndarray:
        """(F,17) float32: coefficients per face that map a centred point to its smooth normal.

        Columns 0-3 and 4-7 times (x, y, z, 1) are the second and third barycentric coordinate.
        Columns 8-10 are the normal of the first corner; 11-13 and 14-16 are multiplied by the two
        coordinates. With one row per face, a pixel needs one look-up.
        """
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        e1, e2 = b - a, c - a
        d11, d12, d22 = (np.einsum("ij,ij->i", x, y) for x, y in ((e1, e1), (e1, e2), (e2, e2)))
        det = d11 * d22 - d12 * d12
        inverse = np.divide(1.0, det, out=np.zeros_like(det), where=det > 0)[:, None]
        table = np.empty((len(a), 17), np.float32)
        for column, (near, far, d) in ((0, (e1, e2, d22)), (4, (e2, e1, d11))):
            gradient = (near * d[:, None] - far * d12[:, None]) * inverse
            table[:, column : column + 3] = gradient
            table[:, column + 3] = -np.einsum("ij,ij->i", gradient, a)
        n = self.corner_normals
        table[:, 8:11] = n[:, 0]
        table[:, 11:14] = n[:, 1] - n[:, 0]
        table[:, 14:17] = n[:, 2] - n[:, 0]
        return table


def prepare_mesh(mesh: trimesh.Trimesh | RenderMesh) -> RenderMesh:
    """Return the prepared form of a mesh in metres, from a cache keyed by its content.

    Thread-safe.
    """
    if isinstance(mesh, RenderMesh):
        return mesh
    key = (hash(mesh.vertices), hash(mesh.faces))
    with _cache_lock:
        found = _cache.get(key)
        if found is None:
            found = RenderMesh.from_arrays(np.asarray(mesh.vertices), np.asarray(mesh.faces))
            _cache[key] = found
            while len(_cache) > _CACHE_SIZE:
                _cache.popitem(last=False)
        else:
            _cache.move_to_end(key)
    return found


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def _corner_angles(triangles: np.ndarray) -> np.ndarray:
    """(F,3) interior angles of (F,3,3) triangles in radians."""
    angles = np.empty(triangles.shape[:2])
    for i in range(3):
        u = _unit(triangles[:, (i + 1) % 3] - triangles[:, i])
        v = _unit(triangles[:, (i + 2) % 3] - triangles[:, i])
        angles[:, i] = np.arccos(np.clip(np.einsum("ij,ij->i", u, v), -1, 1))
    return angles
