"""Cameras, and images without their distortion. Pixel centres are at integers.

`Camera` projects points, unprojects pixels and makes rays, with a lens of `camera_models`. Others
take fx, fy, cx and cy of a pinhole for a reason: compiled loops (alignment of depth, silhouettes,
patch match), torch (`benchmark.methods.torch_camera`), renderers, derivatives, and steps of
optimisers that clamp the depth (`labels.propagate`). BOP's FISHEYE624 is scored beyond 90 degrees.

Lenses that scenes do not keep (fisheye) are undistorted on import and before restoring, by
`Undistortion`. A lens of OpenCV's model stays as it is unless a field of view is asked for. The
images are then as a pinhole at the same place records them; z-depth does not change.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera_models import Lens, OpenCV, Pinhole, lens_of

Array = NDArray[np.float64]

# Smallest distance of the principal point from an edge, as a fraction of the image size, for
# cropped images. In whole images it is within a few percent of the centre; importers check that.
NEAREST_TO_EDGE = 0.27


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


# A position that is outside every image, also for interpolation.
_NOWHERE = -10.0


@dataclass(frozen=True)
class Undistortion:
    """From images of a lens to those of a pinhole of the same size, centre and axes.

    Attributes:
        recorded: camera of the recorded images.
        camera: the pinhole.
    """

    recorded: Camera
    camera: Camera

    @staticmethod
    def of(camera: Camera, fov_deg: float | None = None) -> Undistortion | None:
        """The undistortion that images of a camera need; None if they stay as they are.

        Args:
            camera: of the recorded images.
            fov_deg: horizontal field of view of the pinhole. None undistorts only lenses that
                scenes do not keep, with the lens's K, which keeps the resolution at the centre.

        Raises:
            ToolkitError: a field of view for images without distortion, or of no pinhole camera.
        """
        if fov_deg is None:
            needed = not camera.lens.in_scenes
            return Undistortion(camera, camera.without_distortion()) if needed else None
        field = "--undistort-fov"
        if not camera.is_distorted:
            raise ToolkitError(
                "the images have no lens distortion",
                field=field,
                value=fov_deg,
                hint="leave it out",
            )
        f = camera.width / 2 / np.tan(np.deg2rad(fov_deg) / 2) if 0 < fov_deg < 180 else 0.0
        try:
            target = replace(
                camera.without_distortion(), fx=float(f), fy=float(f * camera.fy / camera.fx)
            )
        except ToolkitError as error:
            raise ToolkitError(
                "no pinhole camera has this horizontal field of view, degrees",
                field=field,
                value=fov_deg,
                hint="between 3 and 136; at most about 110 keeps the corners usable",
            ) from error
        return Undistortion(camera, target)

    def image(
        self, image: NDArray[np.generic], *, interpolation: int = cv2.INTER_LINEAR
    ) -> NDArray[np.generic]:
        """The image (H, W[, C]) undistorted; 0 where the lens sees nothing.

        Use `cv2.INTER_NEAREST` for depth and masks, whose values must not be interpolated.

        Raises:
            ToolkitError: the image has another size than the camera.
        """
        if image.shape[:2] != (self.recorded.height, self.recorded.width):
            raise ToolkitError(
                f"image size differs from the camera's {self.recorded.width}x"
                f"{self.recorded.height}",
                value=image.shape[:2],
            )
        if image.dtype == bool:
            return self.image(image.astype(np.uint8), interpolation=interpolation).astype(bool)
        maps = _undistortion_maps(self)
        return cv2.remap(image, *maps, interpolation=interpolation)  # type: ignore[arg-type]

    def depth(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """A depth map (H, W), each pixel that of the nearest recorded one: z-depth is kept."""
        if values.dtype == np.float16:  # which OpenCV does not resample
            values = values.astype(np.float32)
        return self.image(values, interpolation=cv2.INTER_NEAREST)

    def __str__(self) -> str:
        """What is done to the images, one sentence."""
        c = self.camera
        across, down = (
            2 * np.rad2deg(np.arctan(n / 2 / f)) for n, f in ((c.width, c.fx), (c.height, c.fy))
        )
        u, v = _undistortion_maps(self)
        w, h = self.recorded.size
        inside = (u >= -0.5) & (u <= w - 0.5) & (v >= -0.5) & (v <= h - 0.5)
        kept = "same focal length" if c.K[0, 0] == self.recorded.fx else f"fx {c.fx:.2f}"
        empty = 1 - float(inside.mean())
        text = f"{self.recorded.model} lens undistorted to a pinhole of {across:.1f} x {down:.1f} "
        text += f"degrees ({kept}); change it with --undistort-fov"
        return text + (f"; {empty:.1%} of its pixels are empty" if empty > 0.0005 else "")


def undistort_image(
    image: NDArray[np.generic], camera: Camera, *, interpolation: int = cv2.INTER_LINEAR
) -> NDArray[np.generic]:
    """The image (H, W[, C]) undistorted, as `camera.without_distortion()` would record it.

    See `Undistortion.image`.
    """
    undistortion = Undistortion(camera, camera.without_distortion())
    if not camera.is_distorted and image.shape[:2] == (camera.height, camera.width):
        return image.copy()
    return undistortion.image(image, interpolation=interpolation)


@lru_cache(maxsize=4)
def _undistortion_maps(which: Undistortion) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The source position (H, W) of each pixel; cached: computing takes longer than a remap."""
    recorded, target = which.recorded, which.camera
    if recorded.model == "opencv" and recorded.K.tolist() == target.K.tolist():
        # cv2.undistort keeps K and, like this module, puts pixel centres at integers.
        return cv2.initUndistortRectifyMap(  # type: ignore[return-value]
            recorded.K, np.array(recorded.distortion), np.eye(3), target.K, target.size,
            cv2.CV_32FC1,
        )  # fmt: skip
    uv: Array = np.nan_to_num(recorded.project(target.rays()), nan=_NOWHERE)
    # OpenCV's positions are limited.
    uv = np.clip(uv, _NOWHERE, np.array(recorded.size) - _NOWHERE)
    return uv[..., 0].astype(np.float32), uv[..., 1].astype(np.float32)
