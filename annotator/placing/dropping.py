"""Where a mesh lands that a person drops onto an image: upright, on what is under the pointer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.geometry import SE3, Camera

if TYPE_CHECKING:
    from std_toolkit.labels.support.plane import Plane

# A table-top camera's usual distance, where nothing tells a better one.
USUAL_DISTANCE_M = 0.7
# The way up as a camera sees it that looks down at the usual slant.
USUAL_UP = (0.0, -0.8, -0.6)
# Sensor depth is looked for so far around the pointer.
_REACH_PX = 12


def dropped_pose(
    camera: Camera,
    uv: tuple[float, float],
    vertices: NDArray[np.floating],
    R_cam_obj: NDArray[np.floating],
    *,
    depth: NDArray[np.floating] | None = None,
    table: Plane | None = None,
) -> SE3:
    """T_cam_obj of a mesh dropped at a pixel: the middle of its bounding box appears there.

    On a table that is known it stands on it; else it lies behind what the sensor saw there, or at
    the usual distance.

    Args:
        camera: intrinsics of the frame.
        uv: pixel under the pointer, lens distortion included.
        vertices: (N, 3) of the mesh, metres.
        R_cam_obj: (3, 3) how it is turned.
        depth: (H, W) sensor depth of the frame, metres, or None.
        table: the table in this camera's frame, or None.
    """
    ray = camera.unproject(np.asarray(uv, dtype=np.float64))
    R = np.asarray(R_cam_obj, dtype=np.float64)
    points = np.asarray(vertices, dtype=np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    if table is not None:
        # The middle as high above the table as above the mesh's lowest point.
        height = float(np.max((centre - points) @ (R.T @ table.normal)))
        slope = float(table.normal @ ray)
        distance = (height - table.offset) / slope if abs(slope) > 1e-6 else -1.0
        if 0.05 < distance < 5:
            return SE3(R, ray * distance - R @ centre)
    z = _depth_near(depth, uv)
    # The sensor sees the front; the centre lies half a mesh behind it.
    reach = float(np.linalg.norm(high - low)) / 4 if z is not None else 0.0
    return SE3(R, ray * ((z or USUAL_DISTANCE_M) + reach) - R @ centre)


def upright_rotation(up_cam: ArrayLike, axis: int = 2) -> NDArray[np.float64]:
    """R_cam_obj (3, 3) of a mesh that stands upright, seen from its front.

    Args:
        up_cam: (3,) the way up in the camera's frame.
        axis: the mesh axis that is up (0, 1, 2). The next but one axis points away from the
            camera if z is up, and the next one towards it if y is: the front, as data sets have
            it.
    """
    up = np.asarray(up_cam, dtype=np.float64)
    up = up / np.linalg.norm(up)
    away = np.array([0.0, 0.0, 1.0])
    away = away - (away @ up) * up
    if np.linalg.norm(away) < 1e-3:  # looked at from straight above
        away = np.array([0.0, -1.0, 0.0]) + up[1] * up
    away /= np.linalg.norm(away)
    right = np.cross(away, up)
    # Columns: the mesh's x, y and z axes in the camera's frame.
    if axis == 2:
        columns = [right, away, up]
    elif axis == 1:
        columns = [right, up, -away]
    else:
        columns = [up, away, -right]
    return np.stack(columns, axis=1)


def _depth_near(depth: NDArray[np.floating] | None, uv: tuple[float, float]) -> float | None:
    """Median of the sensor depth around a pixel, metres; None if there is none."""
    if depth is None:
        return None
    u, v = (round(x) for x in uv)
    part = depth[
        max(v - _REACH_PX, 0) : v + _REACH_PX + 1, max(u - _REACH_PX, 0) : u + _REACH_PX + 1
    ]
    measured = part[part > 0]
    return float(np.median(measured)) if len(measured) >= 5 else None
