"""Pinhole camera with OpenCV lens distortion. Pixel centres lie at integer coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one image stream.

    Attributes:
        width, height: image size in pixels.
        fx, fy, cx, cy: pixels; the centre of the top-left pixel is (0, 0).
        distortion: OpenCV coefficients k1 k2 p1 p2 [k3 [k4 k5 k6]], or empty.

    Raises:
        ToolkitError: a value that no camera has, such as a principal point outside the image
            (the mark of intrinsics that belong to another image size).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        hint = "are these the intrinsics of another image size?"
        size = f"{self.width}x{self.height}"
        for name in ("width", "height", "fx", "fy"):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0:
                raise ToolkitError("must be positive", field=name, value=value)
        for name, extent in (("cx", self.width), ("cy", self.height)):
            value = getattr(self, name)
            if not 0.2 * extent <= value <= 0.8 * extent:
                raise ToolkitError(
                    f"lies far from the middle of a {size} image",
                    field=name,
                    value=value,
                    hint=hint,
                )
        for name, extent in (("fx", self.width), ("fy", self.height)):
            value = getattr(self, name)
            # 0.2 is a field of view of 136 degrees, 20 one of 2.9 degrees.
            if not 0.2 * extent <= value <= 20 * extent:
                raise ToolkitError(
                    f"does not fit a {size} image", field=name, value=value, hint=hint
                )
        if len(self.distortion) not in (0, 4, 5, 8):
            raise ToolkitError(
                "distortion has 0, 4, 5 or 8 coefficients (k1 k2 p1 p2 [k3 [k4 k5 k6]])",
                field="distortion",
                value=len(self.distortion),
            )
        if not all(np.isfinite(self.distortion)):
            raise ToolkitError("is not finite", field="distortion", value=self.distortion)

    @property
    def K(self) -> Array:
        """(3, 3) camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.width, self.height

    @property
    def is_distorted(self) -> bool:
        return any(self.distortion)

    def project(self, points: NDArray[np.floating]) -> Array:
        """Pixels (..., 2) of camera-frame points (..., 3). Points with z <= 0 give NaN."""
        p = np.asarray(points, dtype=np.float64)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        x, y = p[..., 0] / z, p[..., 1] / z
        if self.is_distorted:
            x, y = self._distort(x, y)
        return np.stack([self.fx * x + self.cx, self.fy * y + self.cy], axis=-1)

    def unproject(self, uv: NDArray[np.floating], z: NDArray[np.floating] | float = 1.0) -> Array:
        """Camera-frame points (..., 3) at z-depth `z` metres behind the pixels uv (..., 2)."""
        xy = self._normalised(np.asarray(uv, dtype=np.float64))
        depth = np.broadcast_to(np.asarray(z, dtype=np.float64), xy.shape[:-1])
        return np.concatenate([xy * depth[..., None], depth[..., None]], axis=-1)

    def rays(self) -> Array:
        """(H, W, 3) camera-frame points at z = 1 behind every pixel centre."""
        return self.unproject(self.pixel_grid())

    def pixel_grid(self) -> Array:
        """(H, W, 2) pixel coordinates (u, v) of every pixel centre."""
        v, u = np.mgrid[: self.height, : self.width]
        return np.stack([u, v], axis=-1).astype(np.float64)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the image resized to width x height (edges of the image stay edges)."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
        )

    def cropped(self, x: int, y: int, width: int, height: int) -> Crop:
        """The camera of the window of width x height whose top-left pixel is (x, y)."""
        return Crop(width, height, self.fx, self.fy, self.cx - x, self.cy - y, self.distortion)

    def without_distortion(self) -> Camera:
        return replace(self, distortion=())

    def _normalised(self, uv: Array) -> Array:
        if not self.is_distorted:
            return (uv - [self.cx, self.cy]) / [self.fx, self.fy]
        # OpenCV's default stops after 5 iterations, which leaves 0.1 px at wide corners.
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        flat = np.ascontiguousarray(uv.reshape(-1, 1, 2))
        out = cv2.undistortPoints(flat, self.K, np.array(self.distortion), criteria=criteria)
        return np.asarray(out, dtype=np.float64).reshape(uv.shape)

    def _distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *([0.0] * (8 - len(self.distortion))))
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )


class Crop(Camera):
    """A window of a camera's image: its principal point may lie anywhere."""

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise ToolkitError("a crop needs a positive size", value=(self.width, self.height))


def undistort_image(
    image: NDArray[np.generic], camera: Camera, *, interpolation: int = cv2.INTER_LINEAR
) -> NDArray[np.generic]:
    """The image (H, W[, C]) as `camera.without_distortion()` would have seen it.

    Use `cv2.INTER_NEAREST` for depth and masks, whose values must not be mixed.

    Raises:
        ToolkitError: the image has another size than the camera.
    """
    if image.shape[:2] != (camera.height, camera.width):
        raise ToolkitError(
            f"image size differs from the camera's {camera.width}x{camera.height}",
            value=image.shape[:2],
        )
    if not camera.is_distorted:
        return image
    # cv2.undistort keeps K and, like this module, puts pixel centres at integers.
    maps = cv2.initUndistortRectifyMap(
        camera.K, np.array(camera.distortion), np.eye(3), camera.K, camera.size, cv2.CV_32FC1
    )
    return cv2.remap(image, *maps, interpolation=interpolation)  # type: ignore[arg-type]
