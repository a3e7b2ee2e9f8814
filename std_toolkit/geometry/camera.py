"""Pinhole cameras with OpenCV distortion, and z-depth maps. Pixel centres are at integers.

Depth maps: z-depth in metres, 0 = no measurement.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

Array = NDArray[np.float64]

# Smallest distance of the principal point from an edge, as a fraction of the image size, for
# cropped images. In whole images it is within a few percent of the centre; importers check that.
NEAREST_TO_EDGE = 0.27

# Rational models of real lenses reach some hundred.
LARGEST_DISTORTION = 1e4

# Relative to the depth: a table seen at 15 degrees changes by less from pixel to pixel.
LARGEST_DEPTH_STEP = 0.03


# Plausible range of depth for a camera in front of a table or in a room.
SMALLEST_MEDIAN_DEPTH_M = 0.03


LARGEST_MEDIAN_DEPTH_M = 30.0


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one image stream.

    Attributes:
        width, height: image size in pixels.
        fx, fy, cx, cy: pixels; the centre of the top-left pixel is (0, 0).
        distortion: OpenCV coefficients k1 k2 p1 p2 [k3 [k4 k5 k6]], or empty.

    Raises:
        ToolkitError: an impossible value, such as a principal point outside the image (typical
            for intrinsics of another image size).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _check_numbers(self)
        hint = "are these the intrinsics of another image size?"
        size = f"{self.width}x{self.height}"
        for name, extent in (("cx", self.width), ("cy", self.height)):
            value = getattr(self, name)
            # Intrinsics of an image of half or twice the size put it at a quarter or at the edge.
            if not NEAREST_TO_EDGE <= (value + 0.5) / extent <= 1 - NEAREST_TO_EDGE:
                raise ToolkitError(
                    f"is far from the centre of a {size} image",
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
        """Whether the lens has distortion."""
        return any(self.distortion)

    def project(self, points: NDArray[np.floating]) -> Array:
        """Pixels (..., 2) of camera-frame points (..., 3).

        Points with z <= 0 give NaN. So do points far outside the view where the distortion
        polynomial is no longer monotonic and would project them into the image.
        """
        p = np.asarray(points, dtype=np.float64)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        x, y = p[..., 0] / z, p[..., 1] / z
        if self.is_distorted:
            valid = x * x + y * y < largest_radius2(self.distortion)
            x, y = self._distort(np.where(valid, x, np.nan), y)
        return np.stack([self.fx * x + self.cx, self.fy * y + self.cy], axis=-1)

    def unproject(self, uv: NDArray[np.floating], z: NDArray[np.floating] | float = 1.0) -> Array:
        """Camera-frame points (..., 3) at z-depth `z` metres behind the pixels uv (..., 2).

        Pixels far outside the image, where the distortion cannot be inverted, have x and y NaN.
        """
        xy = self._normalised(np.asarray(uv, dtype=np.float64))
        depth = np.broadcast_to(np.asarray(z, dtype=np.float64), xy.shape[:-1])
        return np.concatenate([xy * depth[..., None], depth[..., None]], axis=-1)

    def rays(self) -> Array:
        """(H, W, 3) camera-frame points at z = 1 behind every pixel centre."""
        return pixel_rays(self).copy()

    def pixel_grid(self) -> Array:
        """(H, W, 2) pixel coordinates (u, v) of every pixel centre."""
        v, u = np.mgrid[: self.height, : self.width]
        return np.stack([u, v], axis=-1).astype(np.float64)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the image resized to width x height; image edges map to image edges."""
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
        """The same camera with an ideal lens."""
        return replace(self, distortion=()) if self.distortion else self

    def _normalised(self, uv: Array) -> Array:
        if not self.is_distorted:
            return (uv - [self.cx, self.cy]) / [self.fx, self.fy]
        # OpenCV's default stops after 5 iterations, which leaves 0.1 px at wide corners.
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        flat = np.ascontiguousarray(uv.reshape(-1, 1, 2))
        out = cv2.undistortPoints(flat, self.K, np.array(self.distortion), criteria=criteria)
        xy = np.asarray(out, dtype=np.float64).reshape(uv.shape)
        # Without a solution, the result of the iteration is arbitrary.
        x, y = self._distort(xy[..., 0], xy[..., 1])
        error = np.hypot(self.fx * x + self.cx - uv[..., 0], self.fy * y + self.cy - uv[..., 1])
        wrong = ~(error < 1e-6) | ((xy**2).sum(axis=-1) >= largest_radius2(self.distortion))
        return np.where(wrong[..., None], np.nan, xy)

    def _distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *([0.0] * (8 - len(self.distortion))))
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )


class Crop(Camera):
    """A window of a camera's image: its principal point may be anywhere."""

    def __post_init__(self) -> None:
        _check_numbers(self)


def _check_numbers(camera: Camera) -> None:
    """Check what holds for whole and cropped cameras; convert NumPy numbers to Python."""
    for name in ("width", "height"):
        value = getattr(camera, name)
        try:
            object.__setattr__(camera, name, operator.index(value))
        except TypeError:
            raise ToolkitError("must be a whole number", field=name, value=value) from None
    for name in ("fx", "fy", "cx", "cy"):
        value = float(getattr(camera, name))
        object.__setattr__(camera, name, value)
        if not np.isfinite(value):
            raise ToolkitError("is not finite", field=name, value=value)
    for name in ("width", "height", "fx", "fy"):
        if getattr(camera, name) <= 0:
            raise ToolkitError("must be positive", field=name, value=getattr(camera, name))
    distortion = tuple(float(k) for k in camera.distortion)
    object.__setattr__(camera, "distortion", distortion)
    if len(distortion) not in (0, 4, 5, 8):
        raise ToolkitError(
            "distortion has 0, 4, 5 or 8 coefficients (k1 k2 p1 p2 [k3 [k4 k5 k6]])",
            field="distortion",
            value=len(distortion),
        )
    if not all(np.isfinite(distortion)):
        raise ToolkitError("is not finite", field="distortion", value=distortion)
    if any(abs(k) > LARGEST_DISTORTION for k in distortion):
        raise ToolkitError(
            f"no lens has coefficients above {LARGEST_DISTORTION:g}",
            field="distortion",
            value=distortion,
        )


@lru_cache(maxsize=2)
def pixel_rays(camera: Camera) -> Array:
    """`camera.rays()`, read-only and cached: every frame of a recording needs the same."""
    rays = camera.unproject(camera.pixel_grid())
    rays.flags.writeable = False
    return rays


@lru_cache(maxsize=64)
def largest_radius2(distortion: tuple[float, ...]) -> float:
    """Squared normalised radius below which the radial distortion increases and is invertible.

    r (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3) with s = r^2 increases until the
    first zero of the numerator of its derivative, or of its denominator.
    """
    k1, k2, _, _, k3, k4, k5, k6 = (*distortion, *([0.0] * (8 - len(distortion))))
    s = np.polynomial.Polynomial([0, 1])
    top = 1 + k1 * s + k2 * s**2 + k3 * s**3
    bottom = 1 + k4 * s + k5 * s**2 + k6 * s**3
    slope = top * bottom + 2 * s * (top.deriv() * bottom - top * bottom.deriv())
    zeros = np.concatenate([p.trim().roots() for p in (slope, bottom)])
    real = zeros.real[np.abs(zeros.imag) < 1e-9 * np.maximum(1, np.abs(zeros.real))]
    return float(real[real > 0].min(initial=np.inf))


def undistort_image(
    image: NDArray[np.generic], camera: Camera, *, interpolation: int = cv2.INTER_LINEAR
) -> NDArray[np.generic]:
    """The image (H, W[, C]) undistorted, as `camera.without_distortion()` would record it.

    Use `cv2.INTER_NEAREST` for depth and masks, whose values must not be interpolated.

    Raises:
        ToolkitError: the image has another size than the camera.
    """
    if image.shape[:2] != (camera.height, camera.width):
        raise ToolkitError(
            f"image size differs from the camera's {camera.width}x{camera.height}",
            value=image.shape[:2],
        )
    if not camera.is_distorted:
        return image.copy()
    if image.dtype == bool:
        numbers = undistort_image(image.astype(np.uint8), camera, interpolation=interpolation)
        return numbers.astype(bool)
    maps = _undistortion_maps(camera)
    return cv2.remap(image, *maps, interpolation=interpolation)  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def _undistortion_maps(camera: Camera) -> tuple[Array, Array]:
    """The source position of each pixel; cached: computing takes twice the time of a remap."""
    # cv2.undistort keeps K and, like this module, puts pixel centres at integers.
    distortion = np.array(camera.distortion)
    return cv2.initUndistortRectifyMap(  # type: ignore[return-value]
        camera.K, distortion, np.eye(3), camera.K, camera.size, cv2.CV_32FC1
    )


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
