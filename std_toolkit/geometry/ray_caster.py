"""Ray casts, distances and inside tests on triangle meshes with Embree (Open3D)."""

import sys
import threading
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

_PLOTS = "open3d.visualization.draw_plotly"
_lock = threading.Lock()


def import_open3d() -> ModuleType:
    """The package Open3D, without the web server that its import starts up for plots.

    That is most of the time of its import. The functions that need it import it when called.
    """
    with _lock:
        begun = "open3d" in sys.modules
        if not begun:
            plots = sys.modules[_PLOTS] = ModuleType(_PLOTS)
            for name in ("get_plotly_fig", "draw_plotly", "draw_plotly_server"):
                setattr(plots, name, _plot_later(name))
        try:
            import open3d
        finally:
            if not begun:
                del sys.modules[_PLOTS]
    return open3d


def _plot_later(name: str) -> Callable[..., Any]:
    def plot(*args: Any, **options: Any) -> Any:
        from importlib import import_module

        return getattr(import_module(_PLOTS), name)(*args, **options)

    plot.__name__ = name
    return plot


class RayHits(NamedTuple):
    """First hits of rays, each array in the shape of the rays.

    Attributes:
        distance: (...) float32 in lengths of the ray's direction, inf without a hit.
        mesh: (...) uint32 number of the mesh, in the order of `RayCaster.add`.
        face: (...) uint32 index of the face in its mesh.
        uv: (..., 2) float32 barycentric weights of the face's second and third corner.
        normal: (..., 3) float32 unit normal of the face, by the order of its corners.
    """

    distance: NDArray[np.float32]
    mesh: NDArray[np.uint32]
    face: NDArray[np.uint32]
    uv: NDArray[np.float32]
    normal: NDArray[np.float32]


class RayCaster:
    """Triangle meshes in one frame.

    Embree works in float32: keep coordinates near the origin to preserve precision.

    Args:
        vertices: (V, 3) metres of the first mesh; None to start without a mesh.
        faces: (F, 3) indices of its corners.
        threads: number of threads per query; 0 uses all cores.

    Attributes:
        bounds: (2, 3) low and high corner of the box around all meshes; infinities without one.
    """

    def __init__(
        self, vertices: ArrayLike | None = None, faces: ArrayLike = (), *, threads: int = 0
    ) -> None:
        o3d = import_open3d()
        self._threads = threads
        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
        self.bounds = np.array([np.full(3, np.inf), np.full(3, -np.inf)])
        if vertices is not None:
            self.add(vertices, faces)

    def add(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        """Add a mesh: vertices (V, 3) in metres, faces (F, 3)."""
        if len(at := np.asarray(vertices)):
            low, high = self.bounds
            self.bounds = np.stack(
                [np.minimum(low, at.min(axis=0)), np.maximum(high, at.max(axis=0))]
            )
        self._scene.add_triangles(
            self._floats(vertices), self._tensor(np.ascontiguousarray(faces, dtype=np.uint32))
        )

    def cast(self, rays: ArrayLike) -> RayHits:
        """First hits of rays (..., 6), origin and direction; both sides of a triangle are hit."""
        found = self._scene.cast_rays(self._floats(rays), nthreads=self._threads)
        names = "t_hit", "geometry_ids", "primitive_ids", "primitive_uvs", "primitive_normals"
        return RayHits(*(found[name].numpy() for name in names))

    def occluded(self, rays: ArrayLike) -> NDArray[np.bool_]:
        """(...) whether rays (..., 6) hit a triangle."""
        found = self._scene.test_occlusions(self._floats(rays), nthreads=self._threads)
        return np.asarray(found.numpy())

    def crossings(self, rays: ArrayLike) -> NDArray[np.int32]:
        """(...) number of triangles that rays (..., 6) cross."""
        found = self._scene.count_intersections(self._floats(rays), nthreads=self._threads)
        return np.asarray(found.numpy())

    def crossed(
        self, rays: ArrayLike
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
        """All hits (N,) of rays (R, 6): number of the ray, face, and distance as of `RayHits`."""
        found = self._scene.list_intersections(self._floats(rays), nthreads=self._threads)
        ray, face = (found[name].numpy().astype(np.int64) for name in ("ray_ids", "primitive_ids"))
        return ray, face, found["t_hit"].numpy()

    def distance(self, points: ArrayLike) -> NDArray[np.float32]:
        """(...) unsigned distance in metres from points (..., 3) to the nearest triangle."""
        found = self._scene.compute_distance(self._floats(points), nthreads=self._threads)
        return np.asarray(found.numpy())

    def closest(self, points: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Nearest surface points (..., 3) of points (..., 3) and the unit normals there."""
        place, normal, _ = self.closest_with_faces(points)
        return place, normal

    def closest_with_faces(
        self, points: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """As `closest`, and the faces (...) that the nearest points are on."""
        found = self._scene.compute_closest_points(self._floats(points), nthreads=self._threads)
        return (
            found["points"].numpy(),
            found["primitive_normals"].numpy(),
            found["primitive_ids"].numpy().astype(np.int64),
        )

    def closest_faces(self, points: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Faces (...) nearest to points (..., 3), and weights (..., 2) as `RayHits.uv` there."""
        found = self._scene.compute_closest_points(self._floats(points), nthreads=self._threads)
        return found["primitive_ids"].numpy().astype(np.int64), found["primitive_uvs"].numpy()

    def inside(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(...) whether points (..., 3) are inside the meshes, which must be closed."""
        found = self._scene.compute_occupancy(self._floats(points), nthreads=self._threads)
        return np.asarray(found.numpy() > 0.5)

    def _floats(self, values: ArrayLike) -> Any:
        return self._tensor(np.ascontiguousarray(values, dtype=np.float32))
