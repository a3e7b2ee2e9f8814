"""librealsense's intrinsics and extrinsics as the toolkit's."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.scene.model import CameraModel

Array = NDArray[np.float64]
# A lens that OpenCV's model does not describe to this would shift labels.
LARGEST_RESIDUAL_PX = 0.05
_GRID = 33


def camera_model(intrinsics: Any, stream: str) -> tuple[CameraModel, str]:
    """Intrinsics of a stream, and a note if its lens model had to be converted.

    librealsense counts pixel centres at whole numbers, as the toolkit does. Its "Brown Conrady" is
    OpenCV's model; "Modified Brown Conrady" scales before it bends sideways. "Inverse Brown
    Conrady" (the colour camera of a D455) is documented as leading from distorted to undistorted
    coordinates, but librealsense projects with it as with the modified model, and deprojects
    accordingly (since 2.44; pull request 8523); negative k1, which such wide lenses have, is barrel
    distortion only that way. Here it means what it means there. Both kinds are fitted by OpenCV's.

    Args:
        intrinsics: `rs.intrinsics`.
        stream: its name, for messages.

    Raises:
        ToolkitError: another lens model with coefficients, or one that cannot be fitted.
    """
    i = intrinsics
    # Its name differs among versions: "distortion.brown_conrady", "Brown Conrady".
    kind = str(i.model).rsplit(".", 1)[-1].lower().replace(" ", "_")
    coefficients = [float(k) for k in i.coeffs]
    plain = Camera(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy)
    if not any(coefficients) or kind == "none":
        return CameraModel.of(plain), ""
    if kind == "brown_conrady":
        bent = Camera(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy, tuple(coefficients))
        return CameraModel.of(bent), ""
    if kind not in ("inverse_brown_conrady", "modified_brown_conrady"):
        raise ToolkitError(
            "a lens model that is not known", field=f"intrinsics of {stream}", value=kind
        )
    fitted, residual = _fit(plain, coefficients)
    if residual > LARGEST_RESIDUAL_PX:
        raise ToolkitError(
            f"the lens cannot be told in OpenCV's model: {residual:.2f} px are left",
            field=f"intrinsics of {stream}",
            value=coefficients,
        )
    note = f"{stream}: {kind} lens fitted by OpenCV's model to {residual:.4f} px"
    return CameraModel.of(fitted), note


def pose(extrinsics: Any) -> SE3:
    """`rs.extrinsics` from stream a to stream b as `T_b_a`; its rotation is stored by columns.

    Raises:
        ToolkitError: not a rotation.
    """
    R = np.array(extrinsics.rotation, dtype=np.float64).reshape(3, 3).T
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0:
        raise ToolkitError("is not a rotation", field="extrinsics", value=R.ravel())
    # Stored as float32: 1e-7 from a rotation, which adds up where poses are chained.
    U, _, Vt = np.linalg.svd(R)
    return SE3(U @ Vt, np.array(extrinsics.translation, dtype=np.float64))


def bend(xy: Array, k: list[float], *, scaled_first: bool) -> Array:
    """Normalised coordinates (N, 2) through the polynomial of k1 k2 p1 p2 k3."""
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    f = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    xs, ys = (x * f, y * f) if scaled_first else (x, y)
    return np.stack(
        [
            x * f + 2 * k[2] * xs * ys + k[3] * (r2 + 2 * xs * xs),
            y * f + 2 * k[3] * xs * ys + k[2] * (r2 + 2 * ys * ys),
        ],
        axis=1,
    )


def _fit(plain: Camera, k: list[float]) -> tuple[Camera, float]:
    """The camera in OpenCV's model, and the largest distance in pixels that is left."""
    u = np.linspace(0, plain.width - 1, _GRID)
    v = np.linspace(0, plain.height - 1, _GRID)
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    f, c = np.array([plain.fx, plain.fy]), np.array([plain.cx, plain.cy])
    rays = (grid - c) / f
    pixels = bend(rays, k, scaled_first=True) * f + c

    def left(parameters: Array) -> Array:
        bent = bend(rays, list(parameters), scaled_first=False) * f + c
        return (bent - pixels).ravel()

    found = least_squares(left, np.array(k), x_scale="jac")
    distances = np.hypot(*left(found.x).reshape(-1, 2).T)
    camera = Camera(
        plain.width, plain.height, plain.fx, plain.fy, plain.cx, plain.cy, tuple(found.x)
    )
    return camera, float(distances.max())
