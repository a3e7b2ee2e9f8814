"""The surface of one object in its own frame: ray hits, nearest points, colours.

The rays move instead of the mesh, so that hundreds of poses need only one acceleration structure.

The colours of the surface distinguish poses of equal shape: a box rotated by half a turn, or a can
about its axis, fits sensor depth as well as the right pose; only the texture differs.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import SE3
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]


# Fraction of the radius by which a sphere exceeds the hull of its points in `_directions`.
_SLACK = 0.02


_SMOOTHING_PX = 1.0


@dataclass(frozen=True, kw_only=True)
class SurfaceColorSettings(Settings):
    """When the colours of a surface are informative."""

    plain: float = limit(10.0, unit="grey levels", source="only noise and shading")
    """below this standard deviation a surface is plain"""
    textured: float = limit(25.0, unit="grey levels", source=NOT_RECORDED)
    """above this standard deviation it has a texture"""


@cache
def _directions() -> Array:
    """(162, 3) unit vectors, nowhere more than 11 degrees from the next one."""
    import trimesh

    return np.asarray(trimesh.creation.icosphere(subdivisions=2).vertices)


@dataclass(frozen=True, eq=False)
class SurfaceHits:
    """Hits of N rays on the surface.

    Attributes:
        depth: (N,) float32 z-depth in metres, inf without a hit.
        face: (N,) uint32 index of the face, if hit.
        corners: (N, 2) float32 barycentric weights of the face's second and third corner.
    """

    depth: NDArray[np.float32]
    face: NDArray[np.uint32]
    corners: NDArray[np.float32]
    _normal: NDArray[np.float32]
    _directions: NDArray[np.float32]

    @property
    def normal(self) -> NDArray[np.float32]:
        """(N, 3) unit normals, object frame, towards the camera."""
        return self.facing(slice(None))

    def facing(self, rays: NDArray[np.intp] | slice) -> NDArray[np.float32]:
        """Rows of `normal`, by their indices (M,)."""
        normal = self._normal[rays].copy()
        away = np.einsum("ij,ij->i", normal, self._directions[rays]) > 0
        normal[away] *= -1
        return normal


class ObjectSurface:
    """A mesh for ray casting and closest points; `surface_of` caches those of objects in use.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) triangles.

    Attributes:
        centre: (3,) centre of the bounding box.
        radius: largest distance of a vertex from it, metres.
        thickness: smallest extent of the bounding box, metres.
        outer: (K, 3) outermost vertices in directions all around; the surface exceeds their convex
            hull by less than `slack`, metres.
    """

    def __init__(self, vertices: Array, faces: NDArray[np.integer]) -> None:
        used = vertices[np.unique(faces)]
        self.centre: Array = (used.min(axis=0) + used.max(axis=0)) / 2
        self.thickness = float(np.ptp(used, axis=0).min())
        self.radius = float(np.linalg.norm(used - self.centre, axis=1).max())
        outermost = ((used - self.centre) @ _directions().T).argmax(axis=0)
        self.outer: Array = used[np.unique(outermost)]
        self.slack = _SLACK * self.radius
        self._caster = RayCaster(vertices - self.centre, faces)

    def cast(self, directions: NDArray[np.floating], T_cam_obj: SE3) -> SurfaceHits:
        """Rays of a camera against the object at a pose.

        Args:
            directions: (N, 3) in the camera frame, z = 1, so that the result is z-depth.
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
        found = self._caster.cast(rays)
        return SurfaceHits(found.distance, found.face, found.uv, found.normal, rays[:, 3:])

    def meet(self, rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Ray parameter (...) of hits, inf without one, and the unit normal (..., 3).

        Args:
            rays: (..., 6) origin and direction in the object frame, the origin minus `centre`.
        """
        found = self._caster.cast(rays)
        return found.distance, found.normal

    def may_meet(self, directions: NDArray[np.floating], T_cam_obj: SE3) -> NDArray[np.bool_]:
        """(N,) whether rays pass near the object; the others need not be cast."""
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
        nearest, normal = self._caster.closest(points - self.centre)
        return nearest.astype(np.float64) + self.centre, normal.astype(np.float64)


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


def surface_of(vertices: Array, faces: NDArray[np.int64]) -> ObjectSurface:
    """The surface of a mesh, created once for its arrays and cached as long as they exist."""
    key = id(vertices), id(faces)
    with _lock:
        known = _kept.get(key)
        if known is not None and known[0]() is vertices and known[1]() is faces:
            return known[2]
    surface = ObjectSurface(vertices, faces)

    def drop(_: object) -> None:
        _kept.pop(key, None)

    with _lock:
        _kept[key] = weakref.ref(vertices, drop), weakref.ref(faces, drop), surface
    return surface


def color_agreement(
    rendered: list[NDArray[np.float32]],
    observed: list[NDArray[np.float32]],
    masks: list[NDArray[np.bool_]],
) -> float:
    """Correlation -1 to 1 of rendered and photographed colours over several views.

    The light of each view shifts and scales its colours, so the mean is subtracted per view. Both
    images are smoothed within the mask, so that a pose that is off by a pixel still agrees.

    Args:
        rendered, observed: per view (h, w, 3) RGB.
        masks: per view (h, w) pixels that show the object.

    Returns:
        The correlation, reduced towards 0 if the surface shows too little texture.
    """
    limits = SurfaceColorSettings.current()
    shared = rendered_power = seen_power = 0.0
    count = 0
    for drawn, taken, mask in zip(rendered, observed, masks, strict=True):
        if mask.sum() < 30:
            continue
        a, b = (_smoothed(x, mask)[mask].astype(np.float64) for x in (drawn, taken))
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        shared += float((a * b).sum())
        rendered_power += float((a * a).sum())
        seen_power += float((b * b).sum())
        count += a.size
    if count == 0 or rendered_power <= 0 or seen_power <= 0:
        return 0.0
    contrast = float(np.sqrt(rendered_power / count))
    clear = float(np.clip((contrast - limits.plain) / (limits.textured - limits.plain), 0, 1))
    return clear * shared / float(np.sqrt(rendered_power * seen_power))


def _smoothed(image: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Gaussian means over the pixels of the mask."""
    weight = mask.astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), _SMOOTHING_PX)
    mixed = cv2.GaussianBlur(image * weight[..., None], (0, 0), _SMOOTHING_PX)
    return np.asarray(mixed / np.maximum(total, 1e-6)[..., None], dtype=np.float32)
