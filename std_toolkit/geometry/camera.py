"""Cameras and z-depth maps. Pixel centres are at integers; depth is in metres, 0 = no measurement.

`Camera` projects points, unprojects pixels and makes rays, with a lens of `camera_models`. Others
take fx, fy, cx and cy of a pinhole for a reason: compiled loops (alignment of depth, silhouettes,
patch match), torch (`benchmark.methods.torch_camera`), renderers, derivatives, and steps of
optimisers that clamp the depth (`labels.propagate`). BOP's FISHEYE624 is scored beyond 90 degrees.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera_models import Lens, OpenCV, Pinhole, lens_of

Array = NDArray[np.float64]

# Smallest distance of the principal point from an edge, as a fraction of the image size, for
# cropped images. In whole images it is within a few percent of the centre; importers check that.
NEAREST_TO_EDGE = 0.27

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
        distortion: coefficients of the lens model; empty for a pinhole.
        model: lens model: "opencv" with k1 k2 p1 p2 [k3 [k4 k5 k6]], "fisheye" with k1 k2 k3 k4,
            or another of `camera_models.MODELS`. Cameras of scenes are "opencv".

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
    model: str = "opencv"

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

    @cached_property
    def lens(self) -> Lens:
        """The lens model with its coefficients."""
        return lens_of(self.model, self.distortion)

    @property
    def is_distorted(self) -> bool:
        """Whether the lens is not a pinhole."""
        return not isinstance(self.lens, Pinhole)

    @property
    def opencv_distortion(self) -> tuple[float, ...]:
        """OpenCV's eight coefficients k1 k2 p1 p2 k3 k4 k5 k6; all 0 for a pinhole.

        Raises:
            ToolkitError: the lens has another model.
        """
        if self.model != "opencv":
            raise ToolkitError(
                "needs a pinhole or a lens of OpenCV's radial-tangential model",
                field="model",
                value=self.model,
                hint="undistort the images first; `std-curate import` does",
            )
        return OpenCV(self.distortion).padded

    def project(self, points: NDArray[np.floating]) -> Array:
        """Pixels (..., 2) of camera-frame points (..., 3).

        Points with z <= 0 give NaN, whatever the lens. So do points far outside the view where the
        distortion polynomial is no longer monotonic and would project them into the image.
        """
        p = np.asarray(points, dtype=np.float64)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        x, y = p[..., 0] / z, p[..., 1] / z
        x, y = self.lens.distort(x, y)
        return np.stack([self.fx * x + self.cx, self.fy * y + self.cy], axis=-1)

    def unproject(self, uv: NDArray[np.floating], z: NDArray[np.floating] | float = 1.0) -> Array:
        """Camera-frame points (..., 3) at z-depth `z` metres behind the pixels uv (..., 2).

        Pixels far outside the image, where the distortion cannot be inverted, have x and y NaN.
        """
        xy = self.lens.undistort(np.asarray(uv, dtype=np.float64), self.K)
        depth = np.broadcast_to(np.asarray(z, dtype=np.float64), xy.shape[:-1])
        return np.concatenate([xy * depth[..., None], depth[..., None]], axis=-1)

    def rays(self) -> Array:
        """(H, W, 3) camera-frame points at z = 1 behind every pixel centre."""
        return pixel_rays(self).copy()

    def pinhole_rays(
        self, u: NDArray[np.integer | np.floating], v: NDArray[np.integer | np.floating]
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """x/z of columns u and y/z of rows v, of any shapes, without the lens's distortion.

        For loops over windows of undistorted images, whose rays are separable.
        """
        return (u - self.cx) / self.fx, (v - self.cy) / self.fy

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
        cx, cy = self.cx - x, self.cy - y
        return Crop(width, height, self.fx, self.fy, cx, cy, self.distortion, self.model)

    def without_distortion(self) -> Camera:
        """The same camera with an ideal lens: image size and K are unchanged."""
        if not self.distortion and self.model == "opencv":
            return self
        return replace(self, distortion=(), model="opencv")


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
    _ = camera.lens  # checks the coefficients


@lru_cache(maxsize=2)
def pixel_rays(camera: Camera) -> Array:
    """`camera.rays()`, read-only and cached: every frame of a recording needs the same."""
    rays = camera.unproject(camera.pixel_grid())
    rays.flags.writeable = False
    return rays


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
