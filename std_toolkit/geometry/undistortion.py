"""Undistorted images: as a pinhole at the same place records them. z-depth does not change.

Lenses that scenes do not keep (fisheye) are undistorted on import and before restoring, by
`Undistortion`. A lens of OpenCV's model stays as it is unless a field of view is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Array, Camera

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
        maps = _maps(self)
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
        u, v = _maps(self)
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
def _maps(which: Undistortion) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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
