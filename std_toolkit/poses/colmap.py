"""The border to COLMAP: its pixel origin, its camera models, its pose direction.

COLMAP puts the centre of the top-left pixel at (0.5, 0.5), the toolkit at (0, 0). Everything that
goes in gets half a pixel more, everything that comes out half a pixel less, and only here.
COLMAP's `cam_from_world` is the toolkit's `T_cam_world`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera

HALF_PIXEL = 0.5


def to_colmap_camera(camera: Camera, camera_id: int, *, distorted: bool = False) -> Any:
    """pycolmap.Camera of a camera; `distorted` forces a model with distortion parameters."""
    params = [camera.fx, camera.fy, camera.cx + HALF_PIXEL, camera.cy + HALF_PIXEL]
    k = list(camera.distortion)
    if len(k) > 4:
        # COLMAP's full OpenCV model takes its parameters in OpenCV's order, all eight of them.
        model, params = "FULL_OPENCV", [*params, *k, *([0.0] * (8 - len(k)))]
    elif k or distorted:
        model, params = "OPENCV", [*params, *(k or [0.0] * 4)]
    else:
        model = "PINHOLE"
    return pycolmap.Camera(
        camera_id=camera_id,
        model=model,
        width=camera.width,
        height=camera.height,
        params=params,
        has_prior_focal_length=True,
    )


def from_colmap_camera(camera: Any) -> Camera:
    """Toolkit camera of a pycolmap.Camera.

    Raises:
        ToolkitError: a camera model other than PINHOLE, SIMPLE_PINHOLE, OPENCV and FULL_OPENCV.
    """
    p = [float(x) for x in camera.params]
    name = camera.model_name
    if name == "SIMPLE_PINHOLE":
        p = [p[0], *p]
    elif name not in ("PINHOLE", "OPENCV", "FULL_OPENCV"):
        raise ToolkitError("cannot convert this COLMAP camera model", value=name)
    fx, fy, cx, cy, *k = p
    return Camera(camera.width, camera.height, fx, fy, cx - HALF_PIXEL, cy - HALF_PIXEL, tuple(k))


def to_colmap_pixels(uv: NDArray[np.floating]) -> NDArray[np.float64]:
    """Pixels (..., 2) in COLMAP's origin."""
    return np.asarray(uv, dtype=np.float64) + HALF_PIXEL


def from_colmap_pixels(uv: NDArray[np.floating]) -> NDArray[np.float64]:
    """Pixels (..., 2) in the toolkit's origin."""
    return np.asarray(uv, dtype=np.float64) - HALF_PIXEL


def to_rigid3d(T_cam_world: SE3) -> Any:
    """pycolmap.Rigid3d (`cam_from_world`) of a pose."""
    return pycolmap.Rigid3d(T_cam_world.matrix()[:3])


def from_rigid3d(cam_from_world: Any) -> SE3:
    """Pose `T_cam_world` of a pycolmap.Rigid3d."""
    return SE3.from_matrix(np.asarray(cam_from_world.matrix(), dtype=np.float64))


@contextmanager
def quiet_colmap() -> Iterator[None]:
    """Keep COLMAP's log off the terminal; its failures are exceptions all the same.

    COLMAP's entry points reset their own log level, so the descriptor itself is turned away.
    """
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
