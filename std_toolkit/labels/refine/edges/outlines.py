"""Visible outlines of one object at many poses, and edge responses of an image.

Tracing a contour to a fraction of a pixel takes milliseconds. A search over hundreds of poses
needs only the pixels of an outline and its direction there, at a low resolution. The rays of all
poses are cast together in the object's frame.

A predicted contour is compared with image edges by lookup: a table of responses by direction is
computed once per image. Responses are ranks: a response that few pixels of the window reach has a
high value, and one of many similar edges on a printed table cloth a low one.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine import patch_pixels
from std_toolkit.labels.refine.problem import RefineObject

Array = NDArray[np.float64]

Array32 = NDArray[np.float32]

_MARGIN = 3

_NEAREST_M = 0.05

_SMALLEST_JUMP_M = 0.005

_SMALLEST_JUMP_FOOTPRINTS = 4.0

_CREASE_COSINE = 0.766

# Creases may be invisible on a printed or glossy surface.
_CREASE_WEIGHT = 0.5

DIRECTIONS = 12

_SMOOTHING_PX = 0.7

# The strength of an edge is relative to its surroundings, so that faint borders of glass count.
_SURROUNDINGS_PX = 9

_NOISE_LEVELS = 2.0

_RANKS = 1024

# Limits the value of a single pixel: -log of this.
_RAREST = 0.02


@dataclass(frozen=True, eq=False)
class Window:
    """The part of an image in which an object is searched.

    Attributes:
        camera: camera of the image, at its resolution.
        T_world_cam: camera pose of the image.
        x, y: top-left pixel of the window.
        others: (h, w) z-depth of the other objects, inf = none, metres.
    """

    camera: Camera
    T_world_cam: SE3
    x: int
    y: int
    others: Array32


@dataclass(frozen=True, eq=False)
class Outlines:
    """Outline pixels of all poses.

    Attributes:
        pose: (N,) index of the pose.
        v, u: (N,) row and column in the window.
        angle: (N,) of the outline's normal, in [0, pi).
        weight: (N,) 1, or less for creases.
    """

    pose: NDArray[np.intp]
    v: NDArray[np.intp]
    u: NDArray[np.intp]
    angle: Array32
    weight: Array32


class OutlineCaster:
    """Outlines of an object at any pose."""

    def __init__(self, obj: RefineObject) -> None:
        self._surface = obj.surface

    def outlines(self, window: Window, R: Array, t: Array) -> Outlines:
        """Outlines at the poses T_world_obj = (R (N, 3, 3), t (N, 3))."""
        T, camera = window.T_world_cam, window.camera
        R_cam_obj = T.R.T @ R
        t_cam_obj = (t - T.t) @ T.R
        u, v = self._patches(camera, R_cam_obj, t_cam_obj)
        h, w = window.others.shape
        row, column = v - window.y, u - window.x
        within = ((row >= 1) & (row < h - 1))[:, :, None] & ((column >= 1) & (column < w - 1))[
            :, None, :
        ]
        row, column = np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)
        met, normal, rays = self._cast(camera, R_cam_obj, t_cam_obj, u, v)
        depth = np.zeros(within.shape, np.float32)
        place = _MARGIN, window.others, row, column
        patch_pixels.keep_visible(met, normal, rays, *place, depth)
        seen = depth[depth > 0]
        distance = float(np.median(seen)) if len(seen) else 1.0
        jump = max(_SMALLEST_JUMP_M, _SMALLEST_JUMP_FOOTPRINTS * distance / camera.fx)
        weight = patch_pixels.outline_weights(
            depth, normal, *place, jump, _CREASE_COSINE, _CREASE_WEIGHT
        )
        weight *= within
        at = np.flatnonzero(weight)
        angle = patch_pixels.outline_angles(depth, normal, _MARGIN, distance, jump, at)
        k, y, x = np.unravel_index(at, weight.shape)
        return Outlines(k, row[k, y], column[k, x], angle, weight.ravel()[at])

    def _patches(
        self, camera: Camera, R: Array, t: Array
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Columns (N, w) and rows (N, h) of a patch of equal size around each pose."""
        p = self._surface.outer @ R.transpose(0, 2, 1) + t[:, None]
        z = np.maximum(p[..., 2], _NEAREST_M)
        grids = []
        for axis, f, c in ((0, camera.fx, camera.cx), (1, camera.fy, camera.cy)):
            x = p[..., axis] / z * f + c
            low, high = x.min(axis=1), x.max(axis=1)
            # An object that fills the view is cut off; so is one beside the camera.
            size = min(int(np.ceil((high - low).max())) + 2 * _MARGIN + 2, camera.size[axis])
            first = np.floor((low + high - size) / 2).astype(np.intp)
            grids.append(first[:, None] + np.arange(size))
        return grids[0], grids[1]

    def _cast(
        self,
        camera: Camera,
        R: Array,
        t: Array,
        u: NDArray[np.intp],
        v: NDArray[np.intp],
    ) -> tuple[Array32, Array32, Array32]:
        """z-depth (N, h, w), inf without a hit, normals (N, h, w, 3) and rays (N, h, w, 6).

        All are in the object frame, without the margin of the patches.
        """
        inside = slice(_MARGIN, -_MARGIN)
        across, down = camera.pinhole_rays(u[:, inside], v[:, inside])
        x, y = across.astype(np.float32), down.astype(np.float32)
        rays = np.empty((len(R), y.shape[1], x.shape[1], 6), np.float32)
        eye = -np.einsum("nji,nj->ni", R, t) - self._surface.centre
        R32 = np.ascontiguousarray(R, np.float32)
        patch_pixels.fill_rays(eye.astype(np.float32), R32, x, y, rays)
        return *self._surface.meet(rays), rays


@dataclass(frozen=True, eq=False)
class EdgeMap:
    """Responses of a window of an image.

    Attributes:
        response: (DIRECTIONS, h, w), mean about 0, at most 2.9: rarity in this window of an edge
            of that direction that is as clear.
    """

    response: Array32

    @staticmethod
    def of(image: NDArray[np.uint8], *, tolerance: float) -> EdgeMap:
        """The map of an image (h, w, 3) whose contours are predicted to `tolerance` pixels."""
        smooth: Array32 = np.asarray(
            cv2.GaussianBlur(image.astype(np.float32), (0, 0), _SMOOTHING_PX), dtype=np.float32
        )
        strength, angle = edge_direction(smooth)
        around = cv2.blur(strength, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))
        floor = 0.7 * around + 0.3 * float(np.median(strength)) + _NOISE_LEVELS
        clear = strength / (strength + floor)
        size = 2 * round(tolerance) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        spread = max(0.5, 0.7 * tolerance)
        response = np.empty((DIRECTIONS, *strength.shape), np.float32)
        for k in range(DIRECTIONS):
            centre = (k + 0.5) * np.pi / DIRECTIONS
            # Directions count modulo half a turn: dark on bright or the other way round.
            agreement = np.maximum(np.cos(2 * (angle - centre)), 0) ** 1.5
            near = cv2.dilate((clear * agreement).astype(np.float32), kernel)
            response[k] = cv2.GaussianBlur(near, (0, 0), spread)
        return EdgeMap(_rarity(response))

    def at(self, angle: Array32, v: NDArray[np.intp], u: NDArray[np.intp]) -> Array32:
        """Responses at pixels to contours whose normals have these angles, in [0, pi)."""
        k = np.minimum((angle * (DIRECTIONS / np.pi)).astype(np.intp), DIRECTIONS - 1)
        return self.response[k, v, u]


def edge_direction(image: Array32) -> tuple[Array32, Array32]:
    """Strength of the largest change at every pixel and its direction's angle in [0, pi).

    All channels are combined (Di Zenzo's structure tensor, without smoothing).

    Args:
        image: (h, w, channels).

    Returns:
        Two arrays (h, w).
    """
    gx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3)
    gy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3)
    xx, xy, yy = (np.zeros(gx.shape[:-1], np.float32) for _ in range(3))
    for k in range(image.shape[2]):
        x, y = gx[..., k], gy[..., k]
        xx += x * x
        xy += x * y
        yy += y * y
    strength = np.sqrt(0.5 * (xx + yy + np.sqrt((xx - yy) ** 2 + 4 * xy**2)))
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return strength, np.where(angle < 0, angle + np.float32(np.pi), angle)


def _rarity(values: Array32) -> Array32:
    """-log of the fraction of values that are as large, minus its mean of about 1."""
    top = max(float(values.max()), 1e-6)
    level = np.minimum((values * (_RANKS / top)).astype(np.int32), _RANKS - 1)
    count = np.bincount(level.ravel(), minlength=_RANKS)
    below = (np.cumsum(count) - 0.5 * count) / level.size
    return (-np.log(1 - below + _RAREST) - 1).astype(np.float32)[level]
