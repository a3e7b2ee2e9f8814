"""MSPD: how far a wrong pose moves an object in the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.symmetry import Symmetry

Floats = NDArray[np.float64]

# BOP: what a step leaves out is at most 1 % of the object's extent.
TURN_STEPS = 315
_POINTS_AT_ONCE = 300_000


def mspd(
    estimate: SE3,
    truth: SE3,
    vertices: NDArray[np.floating],
    camera: Camera,
    symmetry: Symmetry | None = None,
    *,
    steps: int = TURN_STEPS,
) -> float:
    """Maximum symmetry-aware projection distance, pixels.

    Source: T. Hodan et al., "BOP Challenge 2020", equation 4.

    Args:
        estimate, truth: T_cam_obj of both.
        vertices: (V, 3) of the mesh, object frame, metres. All of them: unlike distances in space,
            distances of projections need not be largest on the hull.
        camera: projects them, without lens distortion, as BOP does.
        symmetry: of the object; none means the identity alone.
        steps: samples of a full turn for continuous symmetries.

    Returns:
        The distance; infinity where a pose puts a vertex at or behind the camera's plane.

    Raises:
        ToolkitError: vertices of another shape.

    >>> camera = Camera(640, 480, 500, 500, 319.5, 239.5)
    >>> off = SE3(np.eye(3), np.array([0.01, 0, 1.0]))
    >>> mspd(off, SE3(np.eye(3), np.array([0, 0, 1.0])), np.zeros((1, 3)), camera)
    5.0
    """
    points = np.asarray(vertices, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise ToolkitError("must be (V, 3)", field="vertices", value=points.shape)
    seen = _project(camera, (estimate @ points)[None])
    if seen is None:
        return float("inf")
    transforms = [truth @ S for S in (symmetry or Symmetry()).transforms(steps)]
    best = np.inf
    at_once = max(1, _POINTS_AT_ONCE // len(points))
    for begin in range(0, len(transforms), at_once):
        some = transforms[begin : begin + at_once]
        R, t = np.stack([T.R for T in some]), np.stack([T.t for T in some])
        true = _project(camera, points @ R.transpose(0, 2, 1) + t[:, None])
        if true is None:
            return float("inf")
        squared = ((true - seen) ** 2).sum(axis=2).max(axis=1)
        best = min(best, float(np.sqrt(squared.min())))
    return best


def _project(camera: Camera, points: Floats) -> Floats | None:
    """(S, V, 2) pixels, or None if a point is not in front."""
    z = points[..., 2:]
    if not (z > 0).all():
        return None
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    return points[..., :2] / z * focal + centre
