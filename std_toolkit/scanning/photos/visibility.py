"""What a photo shows of a surface: depth, normals, and the colours of places on it."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.photos.views import View
from std_toolkit.settings import Settings, limit

# A box that is nearer to the camera, or behind it, may be anywhere in the photo.
_NEAREST_M = 0.01


@dataclass(frozen=True, kw_only=True)
class VisibilitySettings(Settings):
    """When a photo shows a place of a surface."""

    flattest: float = limit(0.2, source="photos from more aside show a surface too compressed")
    """smallest cosine between the normal and the ray"""


def hull_depth(
    view: View, caster: RayCaster, offset: Array, window: tuple[int, int, int, int]
) -> tuple[Floats, Floats]:
    """z-depth (h, w), 0 beside the surface, and normals (h, w, 3) in the camera frame.

    Args:
        view: the photo.
        caster: surface in world coordinates minus `offset`.
        offset: (3,) metres.
        window: x0, y0, x1, y1.
    """
    x0, y0, x1, y1 = window
    depth = np.zeros((y1 - y0, x1 - x0), np.float32)
    normal = np.zeros((y1 - y0, x1 - x0, 3), np.float32)
    part = part_of(view, caster.bounds + offset, window)
    if part is None:
        return depth, normal
    local, rays = _rays(view, offset, part)
    hits = caster.cast(rays)
    hit = np.isfinite(hits.distance)
    left, top, right, bottom = part
    place = slice(top - y0, bottom - y0), slice(left - x0, right - x0)
    depth[place] = np.where(hit, hits.distance, 0)
    turned = (hits.normal @ view.T_world_cam.R).astype(np.float32)
    turned[(turned * local).sum(axis=-1) > 0] *= -1
    normal[place] = turned
    return depth, normal


def hull_pixels(view: View, caster: RayCaster) -> Mask:
    """Pixels (H, W) of a photo whose rays meet a surface in world coordinates."""
    found = np.zeros(view.image.shape[:2], bool)
    part = part_of(view, caster.bounds, (0, 0, view.camera.width, view.camera.height))
    if part is not None:
        left, top, right, bottom = part
        found[top:bottom, left:right] = caster.occluded(_rays(view, np.zeros(3), part)[1])
    return found


def _rays(
    view: View, offset: Array, window: tuple[int, int, int, int]
) -> tuple[Array, NDArray[np.float32]]:
    """Rays of the pixels of a window: (h, w, 3) with z = 1 in the camera frame, and (h, w, 6)
    origin and direction in world coordinates minus `offset`."""
    left, top, right, bottom = window
    u, v = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
    local = view.camera.unproject(np.stack([u, v], axis=-1))
    rays = np.empty((*u.shape, 6), np.float32)
    rays[..., :3] = view.centre - offset
    rays[..., 3:] = local @ view.T_world_cam.R.T
    return local, rays


def part_of(
    view: View, bounds: Array, window: tuple[int, int, int, int]
) -> tuple[int, int, int, int] | None:
    """The part of a window of a photo without lens distortion that may show a box (2, 3), world.

    No ray beside it can meet what is in the box. None: nothing of the window shows the box.
    """
    x0, y0, x1, y1 = window
    if not np.isfinite(bounds).all():
        return None
    corners = np.stack(np.meshgrid(*bounds.T), axis=-1).reshape(-1, 3)
    uv, z = view.project(corners)
    if not (z > _NEAREST_M).all():
        return window
    low, high = np.floor(uv.min(axis=0)) - 1, np.ceil(uv.max(axis=0)) + 2
    left, top = np.clip(low, (x0, y0), (x1, y1)).astype(int)
    right, bottom = np.clip(high, (x0, y0), (x1, y1)).astype(int)
    if left >= right or top >= bottom:
        return None
    return int(left), int(top), int(right), int(bottom)


def depth_of(view: View, caster: RayCaster) -> Floats:
    """(H, W) z-depth of the surface, the furthest of 3x3 pixels; infinite beside it."""
    whole = (0, 0, view.camera.width, view.camera.height)
    depth, _ = hull_depth(view, caster, np.zeros(3), whole)
    far = np.where(depth > 0, depth, np.float32(np.inf))
    return np.asarray(cv2.dilate(far, np.ones((3, 3), np.uint8)), np.float32)


def seen_from(view: View, places: Array, normals: Array, depth: Floats) -> tuple[Array, Array]:
    """Colours (N, 3) of places in a photo and weights (N,), 0 where it does not show them."""
    limits = VisibilitySettings.current()
    uv, z = view.project(places)
    h, w = view.image.shape[:2]
    uv = np.where(np.isfinite(uv), uv, -10)
    ray = places - view.centre
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    facing = -(ray * normals).sum(axis=1)
    ok = (
        (facing > limits.flattest) & (uv >= 1).all(axis=1) & (uv < np.array([w, h]) - 2).all(axis=1)
    )
    weight = np.zeros(len(places))
    color = np.zeros((len(places), 3))
    if not ok.any():
        return color, weight
    index = np.flatnonzero(ok)
    x, y = (uv[index].T).astype(np.float32)
    # The mask loses weight towards the outline, where the photo mixes object and background.
    inside = _soft_mask(view)
    # The surface that the photo shows there is not nearer.
    column, row = np.rint(uv[index].T).astype(np.int64)
    free = z[index] < depth[row, column] + 0.0008 + 0.002 * z[index]
    value = _sample(view.image, x, y)
    soft = _sample(inside, x, y)
    weight[index] = free * facing[index] * soft * (view.camera.fx / z[index]) / 1000
    color[index] = value
    return color, weight


def vertex_normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """(V, 3) unit normals, weighted by the areas of the faces."""
    corners = vertices[faces]
    of_face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, faces[:, k], of_face)
    return np.asarray(out / (np.linalg.norm(out, axis=1, keepdims=True) + 1e-20))


def _soft_mask(view: View) -> Floats:
    shown = view.shown if view.hidden is None else view.shown & ~view.hidden
    distance = cv2.distanceTransform(shown.astype(np.uint8), cv2.DIST_L2, 3)
    return np.clip((distance - 1.0) / 4.0, 0, 1).astype(np.float32)


def _sample(image: Any, x: Floats, y: Floats) -> Array:
    # OpenCV's maps have at most 32767 rows.
    columns = 4096
    count = len(x)
    padded = -(-count // columns) * columns
    mx = np.zeros(padded, np.float32)
    my = np.zeros(padded, np.float32)
    mx[:count], my[:count] = x, y
    out = []
    for a in range(0, padded // columns, 30000):
        part = slice(a * columns, min(padded, (a + 30000) * columns))
        out.append(
            cv2.remap(
                image, mx[part].reshape(-1, columns), my[part].reshape(-1, columns),
                cv2.INTER_LINEAR,
            ).reshape(-1, *image.shape[2:])
        )  # fmt: skip
    return np.concatenate(out)[:count].astype(np.float64)
