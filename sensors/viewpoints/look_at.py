"""A camera that looks at a point."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

WORLD_UP = (0.0, 0.0, 1.0)
# Sine of the smallest angle between the line of sight and the up vector that still tells a roll.
_LEAST_ANGLE = 1e-6


def look_at(eye: ArrayLike, target: ArrayLike, *, up: ArrayLike = WORLD_UP) -> SE3:
    """T_world_cam of a camera at `eye` whose optical axis goes through `target`.

    Args:
        eye, target: (3,) points in the world, metres.
        up: (3,) direction that points upwards in the image; any length.

    Returns:
        OpenCV camera (x right, y down, z forward) to world; x is perpendicular to `up`.

    Raises:
        ToolkitError: eye and target coincide, or the camera looks along `up`.
    """
    e, t, u = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    forward = t - e
    distance = float(np.linalg.norm(forward))
    if not distance > 0:
        raise ToolkitError("the camera stands at the point that it looks at", value=e.tolist())
    forward /= distance
    right = np.cross(forward, u)
    length = float(np.linalg.norm(right))
    if not length > _LEAST_ANGLE * float(np.linalg.norm(u)):
        raise ToolkitError("the camera looks along its up vector", field="up", value=u.tolist())
    right /= length
    return SE3(np.stack([right, np.cross(forward, right), forward], axis=1), e)
