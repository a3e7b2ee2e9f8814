"""Outlines of labelled objects in an image, to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.caster import NOTHING, LabelCaster
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]

# A chain of boundary pixels leaves its tangent uncertain by 45 degrees; over 7 pixels it is a few.
_TANGENT_REACH = 3
# Halvings of a 2-pixel interval: 1/64 px.
_BISECTIONS = 7
SMALLEST_MASK_PX = 40


@dataclass(frozen=True, eq=False)
class Contour:
    """The visible outline of one object.

    Attributes:
        loops: closed polygons (N, 2) in pixels, in drawing order.
        points: (P, 2) all points of the loops.
        normals: (P, 2) unit normals that point out of the object.
        own: (P,) the object itself ends here: not the image border and nothing in front of it.
        depth: (P,) z-depth in metres of the object just inside.
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
        object_id: whose outline.
        mask: (h, w) pixels whose centre shows the object: part of the image from `origin` on.
        origin: x, y of the mask's top-left pixel in the image.
        shown: (h, w) pixels in which nothing outside the labels hides the object, if known.

    Returns:
        The contour, or None where too little of the object is visible.
    """
    if int(mask.sum()) < SMALLEST_MASK_PX:
        return None
    # A border of zeros, so that a loop never runs along the array's edge unseen.
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    chains, _ = cv2.findContours(padded, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    pixels = [c.reshape(-1, 2).astype(np.float64) - 1 + origin for c in chains if len(c) >= 8]
    if not pixels:
        return None
    # Outer loops and holes run in opposite senses, so that one rule gives outward normals; the
    # sense itself is found from the first (outer) loop by asking the mask.
    normals = [_normals(p, _TANGENT_REACH) for p in pixels]
    inside = np.concatenate(pixels)
    direction = np.concatenate(normals)
    if _outwardness(padded, inside - origin, direction) < 0:
        direction = -direction
    refined, found = _refine(caster, camera, T_world_cam, object_id, inside, direction)

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
    return Contour(loops, points, out, own, here.depth.astype(np.float64))


def _refine(
    caster: LabelCaster,
    camera: Camera,
    T_world_cam: SE3,
    object_id: int,
    inside: Array,
    direction: Array,
) -> tuple[Array, NDArray[np.bool_]]:
    """Points where the object ends along `direction`, and whether it does within 2 px."""
    low = np.zeros(len(inside))
    high = np.full(len(inside), 2.0)
    ends = caster.cast(camera, T_world_cam, inside + high[:, None] * direction)
    found = ends.object_id != object_id
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        hit = caster.cast(camera, T_world_cam, inside + middle[:, None] * direction)
        is_inside = hit.object_id == object_id
        low = np.where(is_inside, middle, low)
        high = np.where(is_inside, high, middle)
    # Where the object goes on for 2 px the chain turns sharply: half a pixel is the best guess.
    along = np.where(found, (low + high) / 2, 0.5)
    return inside + along[:, None] * direction, found


def _normals(loop: Array, reach: int) -> Array:
    """Unit normals of a closed polygon: its tangent over +-reach points, turned right."""
    tangent = np.roll(loop, -reach, axis=0) - np.roll(loop, reach, axis=0)
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    tangent = np.divide(tangent, length, out=np.zeros_like(tangent), where=length > 0)
    return np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)


def _smooth(loop: Array) -> Array:
    """Refined points jump to and fro along the outline where normals cross; even them out."""
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


def svg_path(loops: list[Array], *, scale: float = 1.0, offset: tuple[float, float]) -> str:
    """Path data of closed loops for an SVG whose unit is a pixel of the drawn picture.

    Args:
        loops: polygons in image pixels, centres at integers.
        scale: pixels of the picture per pixel of the image.
        offset: x, y of the picture's top-left pixel in the image.
    """
    parts = []
    for loop in loops:
        # SVG puts the edge of the first pixel, not its centre, at 0.
        drawn = (loop - offset + 0.5) * scale
        thin = cv2.approxPolyDP(drawn.astype(np.float32).reshape(-1, 1, 2), 0.12, True)
        if len(thin) >= 3:
            parts.append("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in thin.reshape(-1, 2)) + "Z")
    return "".join(parts)
