"""Where the table is, for a planner that was not told."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.depth import unproject_depth
from std_toolkit.geometry.se3 import SE3

_POINTS = 20_000
_DISTANCE_M = 0.005
_ROUNDS = 300
# A table that is seen at all fills so much of the view.
_LEAST_SHARE = 0.1


def find_table(
    depth: NDArray[np.float32],
    camera: Camera,
    *,
    not_table: NDArray[np.bool_] | None = None,
    rng: np.random.Generator,
) -> SE3:
    """Pose of the largest plane, T_cam_table: z towards the camera's side, origin on the axis.

    Args:
        depth: (h, w) metres, 0 unknown.
        not_table: (h, w) pixels to leave out, such as those of objects.
        rng: draws the planes that are tried.

    Raises:
        ToolkitError: no plane holds a tenth of the points.
    """
    known = np.isfinite(depth) & (depth > 0)
    if not_table is not None and (known & ~not_table).sum() >= 3:
        known &= ~not_table
    points = unproject_depth(np.where(known, depth, 0), camera)[known]
    if len(points) < 3:
        raise ToolkitError("too little depth to find the table in", value=len(points))
    points = points[rng.permutation(len(points))[:_POINTS]]
    corners = points[rng.integers(len(points), size=(_ROUNDS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    usable = length > 1e-9
    if not usable.any():
        raise ToolkitError("the points lie on a line: there is no table in them")
    normals, corners = normals[usable] / length[usable, None], corners[usable]
    offsets = np.einsum("ni,ni->n", normals, corners[:, 0])
    holds = [np.abs(points @ n - d) < _DISTANCE_M for n, d in zip(normals, offsets, strict=True)]
    best = max(holds, key=np.count_nonzero)
    if best.mean() < _LEAST_SHARE:
        raise ToolkitError(
            "no table is seen: no plane holds a tenth of the points",
            value=round(float(best.mean()), 3),
            hint="give its pose, T_cam_table",
        )
    middle = points[best].mean(axis=0)
    normal = np.linalg.svd(points[best] - middle, full_matrices=False)[2][2]
    up = normal if normal @ middle < 0 else -normal
    x = np.array([1.0, 0, 0]) - up[0] * up
    x /= np.linalg.norm(x)
    return SE3(np.stack([x, np.cross(up, x), up], axis=1), middle)
