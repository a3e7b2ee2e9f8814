"""One object in its own frame: what rays meet, and the surface nearest to points.

The world of all objects must be built anew for every pose that is tried. Here the rays move
instead of the mesh, so that hundreds of poses cost one acceleration structure.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.problem import RefineObject

Array = NDArray[np.float64]


# Of the radius: a sphere bulges so far beyond the hull of its points in `_directions`.
_SLACK = 0.02


@cache
def _directions() -> Array:
    """(162, 3) unit vectors, nowhere more than 11 degrees from the next one."""
    import trimesh

    return np.asarray(trimesh.creation.icosphere(subdivisions=2).vertices)


@dataclass(frozen=True, eq=False)
class SurfaceHits:
    """Where N rays meet the surface.

    Attributes:
        depth: (N,) float32 z-depth in metres, inf where a ray meets nothing.
        normal: (N, 3) float32 unit normal, object frame, towards the camera.
        face: (N,) uint32 index of the face, where a face is met.
        corners: (N, 2) float32 barycentric weights of the face's second and third corner.
    """

    depth: NDArray[np.float32]
    normal: NDArray[np.float32]
    face: NDArray[np.uint32]
    corners: NDArray[np.float32]


class ObjectSurface:
    """A mesh for ray casting and closest points; `surface_of` keeps those of objects in use.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) triangles.

    Attributes:
        centre: (3,) of the bounding box.
        radius: largest distance of a vertex from it, metres.
        thickness: smallest extent of the bounding box, metres.
        outer: (K, 3) vertices that lie outermost in directions all around: what of the surface
            lies outside their convex hull does so by less than `slack`, metres.
    """

    def __init__(self, vertices: Array, faces: NDArray[np.integer]) -> None:
        import open3d as o3d

        used = vertices[np.unique(faces)]
        self.centre: Array = (used.min(axis=0) + used.max(axis=0)) / 2
        self.thickness = float(np.ptp(used, axis=0).min())
        self.radius = float(np.linalg.norm(used - self.centre, axis=1).max())
        outermost = ((used - self.centre) @ _directions().T).argmax(axis=0)
        self.outer: Array = used[np.unique(outermost)]
        self.slack = _SLACK * self.radius
        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene()
        # Embree works in float32: coordinates near the centre keep their digits.
        self._scene.add_triangles(
            self._tensor((vertices - self.centre).astype(np.float32)),
            self._tensor(faces.astype(np.uint32)),
        )

    def cast(self, directions: NDArray[np.floating], T_cam_obj: SE3) -> SurfaceHits:
        """Rays of a camera against the object at a pose.

        Args:
            directions: (N, 3) in the camera frame, z = 1: what comes back is the z-depth.
        """
        return self.cast_from(np.zeros(3), directions, T_cam_obj)

    def cast_from(
        self, origins: Array, directions: NDArray[np.floating], T_world_obj: SE3
    ) -> SurfaceHits:
        """Rays of several cameras against the object at a pose.

        Args:
            origins: (N, 3) of the cameras, world frame, or one for all.
            directions: (N, 3) in the world frame, z = 1 in the camera of each.
        """
        T_obj_world = T_world_obj.inverse()
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3] = T_obj_world @ origins - self.centre
        rays[:, 3:] = turned(directions, T_obj_world.R)
        found = self._scene.cast_rays(self._tensor(rays))
        normal = found["primitive_normals"].numpy()
        away = np.einsum("ij,ij->i", normal, rays[:, 3:]) > 0
        normal[away] *= -1
        return SurfaceHits(
            found["t_hit"].numpy(),
            normal,
            found["primitive_ids"].numpy(),
            found["primitive_uvs"].numpy(),
        )

    def meet(self, rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Ray parameter (...) of what rays meet, inf for nothing, and its normal (..., 3), unit.

        Args:
            rays: (..., 6) origin and direction in the object frame, the origin less `centre`.
        """
        found = self._scene.cast_rays(self._tensor(rays))
        return found["t_hit"].numpy(), found["primitive_normals"].numpy()

    def may_meet(self, directions: NDArray[np.floating], T_cam_obj: SE3) -> NDArray[np.bool_]:
        """(N,) whether rays come near the object: the others need not be cast."""
        c = T_cam_obj @ self.centre
        outside = float(c @ c) - 1.001 * self.radius**2
        if outside <= 0:
            return np.ones(len(directions), dtype=bool)
        x, y = directions[:, 0], directions[:, 1]
        along = x * c[0] + y * c[1] + c[2]
        # Squared distance of the centre from the ray, times the squared length of the direction.
        near = outside * (x * x + y * y + 1) <= along * along
        return np.asarray(near & (along > 0))

    def closest(self, points: Array) -> tuple[Array, Array]:
        """Nearest surface points (N, 3) and the unit normals there (either sign), object frame."""
        shifted = (points - self.centre).astype(np.float32)
        found = self._scene.compute_closest_points(self._tensor(shifted))
        return (
            found["points"].numpy().astype(np.float64) + self.centre,
            found["primitive_normals"].numpy().astype(np.float64),
        )


def rotated(vectors: NDArray[np.float32], R: Array) -> NDArray[np.float32]:
    """(3, ...) R applied to vectors (3, ...), component by component."""
    x, y, z = vectors
    out = np.empty_like(vectors)
    for k, (a, b, c) in enumerate(R.astype(np.float32)):
        out[k] = a * x + b * y + c * z
    return out


def turned(vectors: NDArray[np.floating], R: Array) -> NDArray[np.float32]:
    """(N, 3) R applied to vectors; thin products are slow in linear algebra's libraries."""
    x, y, z = (vectors[:, k].astype(np.float32, copy=False) for k in range(3))
    out = np.empty((len(vectors), 3), np.float32)
    for k, (a, b, c) in enumerate(R.astype(np.float32)):
        out[:, k] = a * x + b * y + c * z
    return out


_Kept = tuple["weakref.ref[Array]", "weakref.ref[NDArray[np.int64]]", ObjectSurface]
_kept: dict[tuple[int, int], _Kept] = {}
_lock = threading.Lock()


def surface_of(thing: RefineObject) -> ObjectSurface:
    """The surface of an object, made once for its arrays and kept as long as they live."""
    key = id(thing.vertices), id(thing.faces)
    with _lock:
        known = _kept.get(key)
        if known is not None and known[0]() is thing.vertices and known[1]() is thing.faces:
            return known[2]
    surface = ObjectSurface(thing.vertices, thing.faces)

    def drop(_: object) -> None:
        _kept.pop(key, None)

    with _lock:
        _kept[key] = weakref.ref(thing.vertices, drop), weakref.ref(thing.faces, drop), surface
    return surface
