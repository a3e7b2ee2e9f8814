"""Sub-pixel outlines of labelled objects in an image.

Sub-pixel contours need rays at arbitrary image positions, which the renderers cannot cast. The
module therefore uses Embree (Open3D) directly. The objects do not move, so it builds the
acceleration structure once per scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.camera import pixel_rays
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scene import Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# The tangent of a chain of boundary pixels is uncertain by 45 degrees, over 7 pixels by a few.
_TANGENT_REACH = 3

# Halvings of a 2-pixel interval: 1/64 px.
_BISECTIONS = 7


_LARGEST_PX = 10_000

NOTHING = 0
"""Object id of a ray that hits no object."""


@dataclass(frozen=True, kw_only=True)
class ContourTraceSettings(Settings):
    """Contours that are traced."""

    smallest_mask_px: int = limit(40, unit="px", source=NOT_RECORDED)
    """a smaller mask has no contour"""


@dataclass(frozen=True, eq=False)
class Contour:
    """The visible outline of one object.

    Attributes:
        loops: closed polygons (N, 2) in pixels, in drawing order.
        points: (P, 2) all points of the loops.
        normals: (P, 2) unit normals that point out of the object.
        own: (P,) whether the object itself ends here: not the image border, not occluded.
        depth: (P,) z-depth in metres of the object at its rim. Half a pixel inside, a round wall
            is millimetres nearer, and would seem to tell how it is turned about its axis.
    """

    loops: list[Array]
    points: Array
    normals: Array
    own: NDArray[np.bool_]
    depth: Array


def trace_contour(
    caster: LabelCaster,
    camera: Camera,
    T_world_cam: SE3,
    object_id: int,
    mask: NDArray[np.bool_],
    *,
    origin: tuple[int, int] = (0, 0),
    shown: NDArray[np.bool_] | None = None,
) -> Contour | None:
    """The outline of a visible mask, refined by rays between the pixel centres.

    Args:
        caster: the labelled objects.
        camera, T_world_cam: the view.
        object_id: id of the object.
        mask: (h, w) pixels whose centre shows the object, a crop of the image at `origin`.
        origin: x, y of the mask's top-left pixel in the image.
        shown: (h, w) pixels in which nothing but labelled objects hides the object, if known.

    Returns:
        The contour, or None if too little of the object is visible.
    """
    if int(mask.sum()) < ContourTraceSettings.current().smallest_mask_px:
        return None
    # A border of zeros, so that a loop never runs along the array's edge unseen.
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    chains, _ = cv2.findContours(padded, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    pixels = [c.reshape(-1, 2).astype(np.float64) - 1 + origin for c in chains if len(c) >= 8]
    if not pixels:
        return None
    # Outer loops and holes have opposite orientations, so that one rule gives outward normals.
    # The orientation of the first (outer) loop is found from the mask.
    normals = [_normals(p, _TANGENT_REACH) for p in pixels]
    inside = np.concatenate(pixels)
    direction = np.concatenate(normals)
    if _outwardness(padded, inside - origin, direction) < 0:
        direction = -direction
    refined, found, rim = _refine(caster, camera, T_world_cam, object_id, inside, direction)

    ends = np.cumsum([len(p) for p in pixels])[:-1]
    loops = [_smooth(x) for x in np.split(refined, ends)]
    smooth_normals = []
    for loop, rough in zip(loops, np.split(direction, ends), strict=True):
        n = _normals(loop, _TANGENT_REACH)
        smooth_normals.append(np.where((n * rough).sum(axis=1, keepdims=True) < 0, -n, n))
    points, out = np.concatenate(loops), np.concatenate(smooth_normals)

    beyond = caster.cast(camera, T_world_cam, refined + 0.75 * direction)
    here = caster.cast(camera, T_world_cam, inside)
    covered = (
        (beyond.object_id != NOTHING)
        & (beyond.object_id != object_id)
        & (beyond.depth < here.depth)
    )
    border = (
        (points < 1.5).any(axis=1)
        | (points[:, 0] > camera.width - 2.5)
        | (points[:, 1] > camera.height - 2.5)
    )
    own = found & ~covered & ~border & (here.object_id == object_id)
    if shown is not None:
        x, y = (inside - origin).astype(int).T
        own &= shown[y, x]
    depth = np.where(rim > 0, rim, here.depth).astype(np.float64)
    return Contour(loops, points, out, own, depth)


def _refine(
    caster: LabelCaster,
    camera: Camera,
    T_world_cam: SE3,
    object_id: int,
    inside: Array,
    direction: Array,
) -> tuple[Array, NDArray[np.bool_], NDArray[np.float32]]:
    """Points where the object ends along `direction`, whether it does within 2 px, and the depth of
    the last hit before, 0 for none."""
    low, depth = np.zeros(len(inside)), np.zeros(len(inside), np.float32)
    high = np.full(len(inside), 2.0)
    ends = caster.cast(camera, T_world_cam, inside + high[:, None] * direction)
    found = ends.object_id != object_id
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        hit = caster.cast(camera, T_world_cam, inside + middle[:, None] * direction)
        is_inside = hit.object_id == object_id
        low = np.where(is_inside, middle, low)
        depth = np.where(is_inside, hit.depth, depth)
        high = np.where(is_inside, high, middle)
    # If the object continues for 2 px, the chain turns sharply: half a pixel is the best estimate.
    along = np.where(found, (low + high) / 2, 0.5)
    return inside + along[:, None] * direction, found, np.where(found, depth, 0)


def _normals(loop: Array, reach: int) -> Array:
    """Unit normals of a closed polygon: its tangent over +-reach points, turned right."""
    tangent = np.roll(loop, -reach, axis=0) - np.roll(loop, reach, axis=0)
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    tangent = np.divide(tangent, length, out=np.zeros_like(tangent), where=length > 0)
    return np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)


def _smooth(loop: Array) -> Array:
    """Smooth the points along the outline: they jump back and forth where normals cross."""
    return 0.25 * np.roll(loop, 1, axis=0) + 0.5 * loop + 0.25 * np.roll(loop, -1, axis=0)


def _outwardness(padded: NDArray[Any], pixels: Array, direction: Array) -> float:
    """Positive where `direction` leaves the mask more often than it enters it."""
    steps = np.rint(1.5 * direction).astype(int)
    x, y = (pixels.astype(int) + 1).T
    height, width = padded.shape

    def filled(sign: int) -> float:
        xx = np.clip(x + sign * steps[:, 0], 0, width - 1)
        yy = np.clip(y + sign * steps[:, 1], 0, height - 1)
        return float(padded[yy, xx].mean())

    return filled(-1) - filled(1)


@dataclass(frozen=True, eq=False)
class Hits:
    """Hits of rays.

    Attributes:
        object_id: (...,) int32, `NOTHING` without a hit.
        depth: (...,) float32 z-depth in metres, 0 without a hit.
    """

    object_id: NDArray[np.int32]
    depth: NDArray[np.float32]


class LabelCaster:
    """The labelled objects of a scene in the world frame.

    Args:
        objects: object id to (vertices (V,3) in the world in metres, faces (F,3)).
    """

    def __init__(self, objects: Mapping[int, tuple[NDArray[Any], NDArray[Any]]]) -> None:
        self.object_ids = sorted(objects)
        self._all = RayCaster(threads=1)
        self._single: dict[int, RayCaster] = {}
        self.corners: dict[int, NDArray[np.float64]] = {}
        self._hulls: dict[int, NDArray[np.float64]] = {}
        for object_id in self.object_ids:
            vertices, faces = objects[object_id]
            self._all.add(vertices, faces)
            self._single[object_id] = RayCaster(vertices, faces, threads=1)
            used = np.asarray(vertices, dtype=np.float64)[np.unique(faces)]
            low, high = used.min(axis=0), used.max(axis=0)
            self.corners[object_id] = np.array(
                [
                    [x, y, z]
                    for x in (low[0], high[0])
                    for y in (low[1], high[1])
                    for z in (low[2], high[2])
                ]
            )
            self._hulls[object_id] = _hull(used, self.corners[object_id])

    @staticmethod
    def of_scene(scene: Scene) -> LabelCaster:
        """The objects of a scene that have a world pose and a readable mesh."""
        objects = {}
        for item in scene.objects.objects:
            T_world_obj = scene.T_world_obj(item.id)
            if T_world_obj is None or mesh_problem(scene, item.model) is not None:
                continue
            mesh = scene.mesh(item.model)
            objects[item.id] = (T_world_obj @ np.asarray(mesh.vertices), np.asarray(mesh.faces))
        return LabelCaster(objects)

    def cast(
        self,
        camera: Camera,
        T_world_cam: SE3,
        uv: NDArray[np.floating],
        *,
        only: int | None = None,
    ) -> Hits:
        """The nearest object behind pixels.

        Args:
            camera: intrinsics with distortion.
            T_world_cam: pose of the camera.
            uv: (..., 2) pixel coordinates, also outside the image.
            only: id of the one object to intersect; the others are ignored.
        """
        found = self._hits(camera.unproject(uv).reshape(-1, 3), T_world_cam, only)
        shape = uv.shape[:-1]
        return Hits(found.object_id.reshape(shape), found.depth.reshape(shape))

    def cast_pixels(
        self,
        camera: Camera,
        T_world_cam: SE3,
        where: NDArray[np.bool_],
        *,
        origin: tuple[int, int] = (0, 0),
        only: int | None = None,
    ) -> Hits:
        """The nearest object behind the N true pixels of `where`, as arrays (N,).

        Args:
            camera, T_world_cam, only: see `cast`.
            where: (h, w) crop of the image at `origin`.
            origin: x, y of its top-left pixel.
        """
        (height, width), (x, y) = where.shape, origin
        rays = pixel_rays(camera)[y : y + height, x : x + width]
        return self._hits(rays[where], T_world_cam, only)

    def _hits(self, rays: Array, T_world_cam: SE3, only: int | None) -> Hits:
        """Hits (N,) of camera-frame rays (N, 3) with z = 1, so that distances are z-depth."""
        if not self.object_ids:
            return Hits(np.zeros(len(rays), np.int32), np.zeros(len(rays), np.float32))
        from std_toolkit.checks.measure.edge_sums import world_rays  # loads numba

        world = world_rays(rays, np.ascontiguousarray(T_world_cam.R), T_world_cam.t)
        answer = (self._all if only is None else self._single[only]).cast(world)
        depth = answer.distance
        hit = np.isfinite(depth) & (depth > 0)
        # A ray without a hit has the largest number of a mesh.
        table = np.array(self.object_ids if only is None else [only], dtype=np.int32)
        object_id = table.take(answer.mesh, mode="clip")
        object_id[~hit] = NOTHING
        depth[~hit] = 0
        return Hits(object_id, depth)

    def possible(self, camera: Camera, T_world_cam: SE3) -> NDArray[np.bool_]:
        """(H, W) pixels that may show an object: inside the outlines of the convex hulls."""
        mask = np.zeros((camera.height, camera.width), bool)
        for object_id in self.object_ids:
            window = self.window(object_id, camera, T_world_cam)
            if window is not None:
                x0, y0, x1, y1 = window
                mask[y0:y1, x0:x1] |= self.within(object_id, camera, T_world_cam, window)
        return mask

    def within(
        self, object_id: int, camera: Camera, T_world_cam: SE3, window: tuple[int, int, int, int]
    ) -> NDArray[np.bool_]:
        """(h, w) pixels of an object's window inside the outline of its convex hull."""
        x0, y0, x1, y1 = window
        part = np.zeros((y1 - y0, x1 - x0), np.uint8)
        uv = camera.project(T_world_cam.inverse() @ self._hulls[object_id]) - (x0, y0)
        # Lens distortion bends the lines of a hull, and OpenCV's coordinates are limited.
        if camera.is_distorted or not (np.abs(uv) < _LARGEST_PX).all():
            part[:] = 1
        else:
            outline = cv2.convexHull(np.rint(uv).astype(np.int32))
            cv2.fillConvexPoly(part, outline, 1)
            cv2.polylines(part, [outline], isClosed=True, color=1, thickness=5)
        return part.astype(bool)

    def window(
        self, object_id: int, camera: Camera, T_world_cam: SE3
    ) -> tuple[int, int, int, int] | None:
        """Pixels x0, y0, x1, y1 (exclusive) that may show the object, clipped to the image.

        The whole image when the object reaches behind the camera; None when it is out of view.
        """
        p = T_world_cam.inverse() @ self.corners[object_id]
        if (p[:, 2] <= 0).all():
            return None
        if (p[:, 2] <= 0.01).any():
            return 0, 0, camera.width, camera.height
        # The bounding box of the corners bounds a pinhole projection. Lens distortion bends the
        # lines between the corners by less than the margin.
        uv = camera.project(p)
        if not np.isfinite(uv).all():  # beyond what the lens model covers
            return 0, 0, camera.width, camera.height
        margin = 2 + (0.05 * camera.width if camera.is_distorted else 0)
        x0, y0 = np.floor(uv.min(axis=0) - margin)
        x1, y1 = np.ceil(uv.max(axis=0) + margin) + 1
        box = (
            int(np.clip(x0, 0, camera.width)),
            int(np.clip(y0, 0, camera.height)),
            int(np.clip(x1, 0, camera.width)),
            int(np.clip(y1, 0, camera.height)),
        )
        return box if box[2] > box[0] and box[3] > box[1] else None


def _hull(points: Array, box: Array) -> Array:
    """Corners (N, 3) of the convex hull of points; those of their box if they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return box


def mesh_problem(scene: Scene, model_id: str) -> str | None:
    """Why the mesh of a model cannot be used, in one line; None if it is usable."""
    try:
        scene.mesh(model_id)
    except ToolkitError as error:
        return str(error)
    return None


def object_centre(scene: Scene, object_id: int) -> NDArray[np.float64]:
    """(3,) centre of the bounding box of a labelled object in the world."""
    T_world_obj = scene.T_world_obj(object_id)
    assert T_world_obj is not None
    bounds = np.asarray(scene.mesh(scene.objects.object(object_id).model).bounds)
    return T_world_obj @ bounds.mean(axis=0)
