"""Intrinsics as other programs file them: without an image size, with their lens."""

from __future__ import annotations

from dataclasses import dataclass, field

from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry.camera import Camera

# Largest distance of the principal point of an uncropped image from its centre, as a fraction of
# the image. Half-size intrinsics put it at a quarter, those of a 4:3 image on 16:9 at two thirds.
_OFF_CENTRE = 0.15


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics as read; pixels, centre of the top-left pixel at (0, 0).

    Attributes:
        distortion: coefficients of the lens model `model`.
        size: (width, height) if the source has it.
        model: as in `Camera`.
        depth_scale: metres per unit of 16-bit depth images, if the source states it.
        notes: sentences on what was read, and from which keys.
        is_cropped: whether the source states that the image is a part of a larger one.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    size: tuple[int, int] | None = None
    model: str = "opencv"
    depth_scale: float | None = field(default=None, compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)
    is_cropped: bool = field(default=False, compare=False)

    @staticmethod
    def of(camera: Camera) -> Intrinsics:
        """The intrinsics of a camera, with its image size."""
        c = camera
        return Intrinsics(c.fx, c.fy, c.cx, c.cy, c.distortion, c.size, c.model)

    def camera(self, size: tuple[int, int], *, path: str, off_centre: bool = False) -> Camera:
        """The camera for images of `size`.

        Raises:
            ToolkitError: the intrinsics belong to another size.
        """
        shown = f"{size[0]}x{size[1]}"
        if self.size is not None and self.size != size:
            raise ToolkitError(
                f"intrinsics are for {self.size[0]}x{self.size[1]} images, these are {shown}",
                path=path,
                hint="give the intrinsics for this image size",
            )
        with located(path):
            camera = Camera(*size, self.fx, self.fy, self.cx, self.cy, self.distortion, self.model)
        for name, value, extent in (("cx", self.cx, size[0]), ("cy", self.cy, size[1])):
            if (
                not (off_centre or self.is_cropped)
                and abs((value + 0.5) / extent - 0.5) > _OFF_CENTRE
            ):
                raise ToolkitError(
                    f"does not fit {shown} images: the centre is at {(extent - 1) / 2:g}",
                    path=path,
                    field=name,
                    value=value,
                    hint="intrinsics of another image size? for cropped images give --off-centre",
                )
        return camera

    def scene_camera(self, size: tuple[int, int], *, path: str) -> Camera:
        """The camera for images of `size` that are used as they are.

        Raises:
            ToolkitError: as `camera`, or images of this lens must be undistorted first.
        """
        camera = self.camera(size, path=path)
        if not camera.lens.in_scenes:
            raise ToolkitError(
                "images of this lens must be undistorted first",
                path=path,
                field="model",
                value=self.model,
                hint="a recording that `std-curate import` reads is undistorted",
            )
        return camera
