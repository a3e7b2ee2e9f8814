"""Does one pose of the object explain what all frames show?

In every frame the best shift of the contour says where the image has the object, relative to its
label. A label that is off gives shifts that one correction in the world explains: refine it. Wrong
camera poses or a wrong scale give shifts that no correction explains: the label drifts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]

FEWEST_FRAMES = 3
# How far labels are off at most, and how exact one shift is: keeps depth, which a narrow sweep
# leaves open, from running away.
_PRIOR_M = 0.02
_SHIFT_PX = 0.5


@dataclass(frozen=True)
class Consistency:
    """Shifts of one object over the frames.

    Attributes:
        frames: number of frames with a shift.
        spread_px: median distance of the shifts from their median.
        offset_m: (3,) translation in the world that explains the shifts best; its length is how
            far the label seems off.
        drift_px, drift_m: median length of what remains of the shifts after that correction, in
            the image and at the object.
    """

    frames: int
    spread_px: float
    offset_m: tuple[float, float, float]
    drift_px: float
    drift_m: float


def shift_jacobian(camera: Camera, T_world_cam: SE3, point_world: Array) -> tuple[Array, float]:
    """How the image of a point moves with the point: (2, 3) px per metre in the world; its z."""
    R = T_world_cam.R.T
    x, y, z = R @ (point_world - T_world_cam.t)
    J = np.array(
        [[camera.fx / z, 0, -camera.fx * x / z**2], [0, camera.fy / z, -camera.fy * y / z**2]]
    )
    return J @ R, float(z)


def fit_consistency(
    shifts_px: NDArray[np.floating],
    jacobians: NDArray[np.floating],
    metres_per_px: NDArray[np.floating],
) -> Consistency | None:
    """Split shifts over frames into one correction of the label and drift.

    Args:
        shifts_px: (F, 2) shift of the image against the label.
        jacobians: (F, 2, 3) px per metre, from `shift_jacobian`.
        metres_per_px: (F,) size of a pixel at the object.

    Returns:
        None with fewer than `FEWEST_FRAMES` frames.
    """
    d = np.asarray(shifts_px, dtype=np.float64)
    if len(d) < FEWEST_FRAMES:
        return None
    J = np.asarray(jacobians, dtype=np.float64)
    offset = np.zeros(3)
    for _ in range(20):
        r = d - J @ offset
        length = np.linalg.norm(r, axis=1)
        # Cauchy weights: a shift that caught another edge must not pull.
        scale = max(1.4826 * float(np.median(length)), _SHIFT_PX)
        w = 1 / (1 + (length / scale) ** 2)
        A = np.einsum("f,fij,fik->jk", w, J, J) / _SHIFT_PX**2 + np.eye(3) / _PRIOR_M**2
        step = np.linalg.solve(A, np.einsum("f,fij,fi->j", w, J, d) / _SHIFT_PX**2) - offset
        offset = offset + step
        if np.linalg.norm(step) < 1e-7:
            break
    left = np.linalg.norm(d - J @ offset, axis=1)
    return Consistency(
        len(d),
        float(np.median(np.linalg.norm(d - np.median(d, axis=0), axis=1))),
        (float(offset[0]), float(offset[1]), float(offset[2])),
        float(np.median(left)),
        float(np.median(left * metres_per_px)),
    )
