"""The visible outlines of one object at many poses at once, in one image at a low resolution.

Tracing a contour to a fraction of a pixel costs milliseconds; a search that tries hundreds of
poses needs only the pixels at which an outline passes and its direction there. The rays of all
poses are cast together in the object's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.edge_map import edge_direction
from std_toolkit.labels.refine.object_surface import surface_of
from std_toolkit.labels.refine.problem import RefineObject

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

_MARGIN = 3
_NEAREST_M = 0.05
_SMALLEST_JUMP_M = 0.005
_SMALLEST_JUMP_FOOTPRINTS = 4.0
_CREASE_COSINE = 0.766
# Creases need not show on a printed or glossy surface.
_CREASE_WEIGHT = 0.5


@dataclass(frozen=True, eq=False)
class Window:
    """The part of an image in which an object is looked for.

    Attributes:
        camera: of the image, at its resolution.
        T_world_cam: of the image.
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
    """Pixels at which outlines pass, of all poses together.

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

    def __init__(self, thing: RefineObject) -> None:
        self._surface = surface_of(thing)

    def outlines(self, window: Window, R: Array, t: Array) -> Outlines:
        """Outlines at the poses T_world_obj = (R (N, 3, 3), t (N, 3))."""
        T, camera = window.T_world_cam, window.camera
        R_cam_obj = T.R.T @ R
        t_cam_obj = (t - T.t) @ T.R
        u, v = self._patches(camera, R_cam_obj, t_cam_obj)
        depth, normal = self._cast(camera, R_cam_obj, t_cam_obj, u, v)
        h, w = window.others.shape
        row, column = v - window.y, u - window.x
        within = ((row >= 1) & (row < h - 1))[:, :, None] & ((column >= 1) & (column < w - 1))[
            :, None, :
        ]
        row, column = np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)
        others = window.others[row[:, :, None], column[:, None, :]]
        visible = np.isfinite(depth) & (depth < others)
        depth = np.where(visible, depth, np.float32(0))
        normal *= visible[..., None]
        distance = float(np.median(depth[visible])) if visible.any() else 1.0
        jump = max(_SMALLEST_JUMP_M, _SMALLEST_JUMP_FOOTPRINTS * distance / camera.fx)
        passing = _passing(visible, depth, normal, others, jump)
        k, y, x = np.nonzero(passing * within)
        angle = _angles(visible, (depth - np.float32(distance)) / np.float32(jump), normal)
        return Outlines(k, row[k, y], column[k, x], angle[k, y, x], passing[k, y, x])

    def _patches(
        self, camera: Camera, R: Array, t: Array
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Columns (N, w) and rows (N, h) of a patch around each pose, all of one size."""
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
    ) -> tuple[Array32, Array32]:
        """z-depth (N, h, w) and normals towards the camera (N, h, w, 3), object frame."""
        shape = len(R), v.shape[1], u.shape[1]
        depth = np.full(shape, np.inf, np.float32)
        normal = np.zeros((*shape, 3), np.float32)
        # In the margin there is nothing.
        inside = slice(_MARGIN, -_MARGIN)
        u, v = u[:, inside], v[:, inside]
        x = ((u - camera.cx) / camera.fx).astype(np.float32)[:, None, :]
        y = ((v - camera.cy) / camera.fy).astype(np.float32)[:, :, None]
        R32 = R.astype(np.float32)
        rays = np.empty((len(R), v.shape[1], u.shape[1], 6), np.float32)
        eye = -np.einsum("nji,nj->ni", R, t) - self._surface.centre
        rays[..., :3] = eye[:, None, None]
        for k in range(3):
            a, b, c = (R32[:, i, k, None, None] for i in range(3))
            rays[..., 3 + k] = x * a + y * b + c
        depth[:, inside, inside], met = self._surface.meet(rays)
        away = np.asarray(sum(met[..., k] * rays[..., 3 + k] for k in range(3)) > 0)
        np.negative(met, out=met, where=away[..., None])
        normal[:, inside, inside] = met
        return depth, normal


def _passing(
    visible: NDArray[np.bool_],
    depth: Array32,
    normal: Array32,
    others: Array32,
    jump: float,
) -> Array32:
    """(N, h, w) weight of the outline at each pixel: both pixels beside it have it."""
    weight = np.zeros(visible.shape, np.float32)
    for axis in (1, 2):
        a = tuple(slice(None, -1) if k == axis else slice(None) for k in range(3))
        b = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        # Where something nearer begins, the border is not the object's.
        ends = visible[a] & ~visible[b] & (others[b] > depth[a])
        begins = visible[b] & ~visible[a] & (others[a] > depth[b])
        both = visible[a] & visible[b]
        hides = both & (np.abs(depth[b] - depth[a]) > jump)
        cosine = sum(normal[(*a, k)] * normal[(*b, k)] for k in range(3))
        crease = both & (cosine < _CREASE_COSINE)
        here = np.where(
            ends | begins | hides, np.float32(1), np.where(crease, np.float32(_CREASE_WEIGHT), 0)
        )
        np.maximum(weight[a], here, out=weight[a])
        np.maximum(weight[b], here, out=weight[b])
    return weight


def _angles(visible: NDArray[np.bool_], relief: Array32, normal: Array32) -> Array32:
    """(N, h, w) direction of what changes: mask, depth in jumps, or normal."""
    n, h, w = visible.shape
    channels = np.empty((n * h, w, 5), np.float32)
    channels[..., 0] = 2 * visible.reshape(n * h, w)
    channels[..., 1] = np.clip(relief, -6, 6).reshape(n * h, w) * visible.reshape(n * h, w)
    channels[..., 2:] = normal.reshape(n * h, w, 3)
    # The margins keep the patches, one above the other, apart.
    smooth = np.asarray(cv2.blur(channels, (3, 3)), dtype=np.float32)
    return edge_direction(smooth)[1].reshape(n, h, w)
