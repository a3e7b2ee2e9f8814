"""Mapping between image, eye and screen coordinates with subpixel accuracy.

Screen positions are (x, y) from the top-left corner of the drawing area, x right, y down, in
physical pixels; the first pixel covers 0 to 1. Image positions have pixel centres at integers, so
the first pixel covers -0.5 to 0.5. Only this module handles the half-pixel offset.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.geometry import Camera

Array = NDArray[np.float64]

# Largest zoom, screen pixels per image pixel.
LARGEST_SCALE = 64.0
SMALLEST_SHARE = 0.25  # of the scale at which the whole image is visible


@dataclass(frozen=True)
class ScreenCamera:
    """Pinhole of a view: eye coordinates (x right, y down, z forward; metres) to the screen.

    Attributes:
        width, height: of the drawing area in physical pixels.
        fx, fy, cx, cy: in screen pixels; the corner of the top-left pixel is (0, 0).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def project(self, points: NDArray[np.floating]) -> Array:
        """Return screen positions (..., 2) of eye points (..., 3); NaN behind the eye."""
        p = np.asarray(points, dtype=np.float64)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        return np.stack(
            [self.fx * p[..., 0] / z + self.cx, self.fy * p[..., 1] / z + self.cy], axis=-1
        )

    def ray(self, xy: ArrayLike) -> Array:
        """Return the (..., 3) points at z = 1 of screen positions (..., 2)."""
        s = np.asarray(xy, dtype=np.float64)
        x, y = (s[..., 0] - self.cx) / self.fx, (s[..., 1] - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def pixel_m(self, z: float) -> float:
        """Size of a screen pixel in metres at depth z."""
        return 2 * z / (self.fx + self.fy)

    def clip_matrix(self, near: float, far: float) -> Array:
        """Return the (4, 4) OpenGL projection of points (x, -y, -z) into the clip cube."""
        P = np.zeros((4, 4))
        P[0, 0] = 2 * self.fx / self.width
        P[0, 2] = 1 - 2 * self.cx / self.width
        P[1, 1] = 2 * self.fy / self.height
        P[1, 2] = 2 * self.cy / self.height - 1
        P[2, 2] = -(far + near) / (far - near)
        P[2, 3] = -2 * far * near / (far - near)
        P[3, 2] = -1
        return P


@dataclass(frozen=True)
class ImageWindow:
    """The part of an image that a drawing area shows.

    Attributes:
        scale: screen pixels per image pixel.
        x, y: screen position of the image's top-left corner.
    """

    scale: float
    x: float
    y: float

    @staticmethod
    def fit(image: tuple[int, int], screen: tuple[int, int]) -> ImageWindow:
        """Return the window that shows the whole image (width, height), centred and maximal."""
        scale = min(screen[0] / image[0], screen[1] / image[1])
        return ImageWindow(
            scale, (screen[0] - scale * image[0]) / 2, (screen[1] - scale * image[1]) / 2
        )

    @staticmethod
    def around(middle: ArrayLike, reach: float, screen: tuple[int, int]) -> ImageWindow:
        """Return the window centred at the image position `middle` with `reach` pixels around."""
        u, v = np.asarray(middle, dtype=np.float64)
        scale = min(min(screen) / (2 * reach), LARGEST_SCALE)
        return ImageWindow(
            scale, screen[0] / 2 - scale * (u + 0.5), screen[1] / 2 - scale * (v + 0.5)
        )

    def to_screen(self, uv: ArrayLike) -> Array:
        """Screen positions (..., 2) of image positions (..., 2)."""
        return (np.asarray(uv, dtype=np.float64) + 0.5) * self.scale + [self.x, self.y]

    def to_image(self, xy: ArrayLike) -> Array:
        """Image positions (..., 2), pixel centres at integers, of screen positions (..., 2)."""
        return (np.asarray(xy, dtype=np.float64) - [self.x, self.y]) / self.scale - 0.5

    def zoomed(self, factor: float, at: ArrayLike) -> ImageWindow:
        """Magnify by `factor`; the point at the screen position `at` stays there."""
        x, y = np.asarray(at, dtype=np.float64)
        return ImageWindow(
            self.scale * factor, x + (self.x - x) * factor, y + (self.y - y) * factor
        )

    def panned(self, dx: float, dy: float) -> ImageWindow:
        """Shifted by screen pixels."""
        return replace(self, x=self.x + dx, y=self.y + dy)

    def kept_in_sight(self, image: tuple[int, int], screen: tuple[int, int]) -> ImageWindow:
        """Return the nearest window with a valid scale that shows some of the image."""
        whole = ImageWindow.fit(image, screen).scale
        scale = float(np.clip(self.scale, SMALLEST_SHARE * whole, LARGEST_SCALE))
        window = self
        if scale != self.scale:
            window = self.zoomed(scale / self.scale, (screen[0] / 2, screen[1] / 2))
        margin = 0.2 * min(screen)
        return ImageWindow(
            window.scale,
            float(np.clip(window.x, margin - scale * image[0], screen[0] - margin)),
            float(np.clip(window.y, margin - scale * image[1], screen[1] - margin)),
        )

    def screen_camera(self, camera: Camera, screen: tuple[int, int]) -> ScreenCamera:
        """Return the pinhole of `camera` without distortion for this window."""
        cx, cy = self.to_screen((camera.cx, camera.cy))
        return ScreenCamera(
            *screen, camera.fx * self.scale, camera.fy * self.scale, float(cx), float(cy)
        )
