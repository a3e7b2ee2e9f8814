"""Maps of z-depth, metres, 0 = no measurement: points, distances, steps, and their unit."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, pixel_rays

# Relative to the depth: a table seen at 15 degrees changes by less from pixel to pixel.
LARGEST_DEPTH_STEP = 0.03


# Plausible range of depth for a camera in front of a table or in a room.
SMALLEST_MEDIAN_DEPTH_M = 0.03


LARGEST_MEDIAN_DEPTH_M = 30.0


def unproject_depth(depth: NDArray[np.floating], camera: Camera) -> NDArray[np.float64]:
    """Camera-frame points (H, W, 3) in metres of every pixel; (0, 0, 0) where depth is 0.

    Raises:
        ToolkitError: the map has another size than the camera.
    """
    _check_size(depth, camera)
    return pixel_rays(camera) * np.asarray(depth, dtype=np.float64)[..., None]


def z_to_distance(depth: NDArray[np.floating], camera: Camera) -> NDArray[np.float64]:
    """Distance from the camera centre (H, W), metres, of a z-depth map. 0 stays 0.

    Raises:
        ToolkitError: the map has another size than the camera.
    """
    _check_size(depth, camera)
    return np.asarray(depth, dtype=np.float64) * np.linalg.norm(pixel_rays(camera), axis=-1)


def on_depth_step(depth: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Pixels (H, W) at a depth discontinuity, where sensors report flying pixels."""
    measured = np.asarray(depth, dtype=np.float32)
    far = cv2.dilate(measured, np.ones((3, 3), np.uint8))
    filled = np.where(measured > 0, measured, np.float32(np.inf))
    near = cv2.erode(filled, np.ones((3, 3), np.uint8))
    return np.asarray((measured > 0) & (far - near > LARGEST_DEPTH_STEP * measured))


def _check_size(depth: NDArray[np.floating], camera: Camera) -> None:
    if np.shape(depth) != (camera.height, camera.width):
        raise ToolkitError(
            f"the size of the depth map is not that of the camera, {camera.width}x{camera.height}",
            value=np.shape(depth)[::-1],
        )


def check_depth_unit(path: Path, depth: NDArray[np.float32], scale: float | None) -> None:
    # The median is robust: sensors report single pixels at 60 m, where no table-top scene is.
    measured = depth[::4, ::4]
    measured = measured[measured > 0]
    if len(measured) < 100:
        return
    middle = float(np.median(measured))
    if not SMALLEST_MEDIAN_DEPTH_M <= middle <= LARGEST_MEDIAN_DEPTH_M:
        raise ToolkitError(
            "the median depth is implausible in metres",
            path=path,
            value=f"{middle:.4g} m",
            hint=f"is the unit right? depth_scale in scene.json is {scale}",
        )
