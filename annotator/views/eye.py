"""From where a view looks: the frame's camera, or an eye that goes around in the cloud."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from annotator.views.projection import ImageWindow, ScreenCamera
from std_toolkit.geometry import SE3, Camera, so3_exp

Array = NDArray[np.float64]

# The eye goes no nearer to what it turns around, and no farther.
NEAREST_M, FARTHEST_M = 0.03, 20.0


class Eye:
    """The eye of one view. Zooming and panning of the image and of the cloud share one window,
    so that switching between them keeps every object where it is on the screen.

    Attributes:
        window: part of the image shown; None for all of it.
        T_eye_ref: where the eye has gone in the cloud, from the frame of reference; None while it
            is in the frame's camera.
    """

    def __init__(self) -> None:
        self.window: ImageWindow | None = None
        self.T_eye_ref: SE3 | None = None

    def shown(self, camera: Camera, screen: tuple[int, int]) -> ImageWindow:
        """The part of the image that is shown."""
        if self.window is None:
            return ImageWindow.fit(camera.size, screen)
        return self.window

    def screen_camera(self, camera: Camera, screen: tuple[int, int]) -> ScreenCamera:
        return self.shown(camera, screen).screen_camera(camera, screen)

    def T_eye_cam(self, T_ref_cam: SE3) -> SE3:
        """The frame's camera as seen by the eye."""
        return SE3.identity() if self.T_eye_ref is None else self.T_eye_ref @ T_ref_cam

    def fit(self) -> None:
        """The whole image, from the frame's camera."""
        self.window = None
        self.T_eye_ref = None

    def look_at(self, uv: ArrayLike, reach: float, screen: tuple[int, int]) -> None:
        """Bring the image position `uv` and `reach` pixels around it close."""
        self.window = ImageWindow.around(uv, reach, screen)

    def zoom(self, factor: float, at: ArrayLike, camera: Camera, screen: tuple[int, int]) -> None:
        """Magnify the image; what lies at the screen position `at` stays there."""
        window = self.shown(camera, screen).zoomed(factor, at)
        window = window.kept_in_sight(camera.size, screen)
        whole = ImageWindow.fit(camera.size, screen)
        # Zooming out ends in the fitted image, which then follows the size of the window.
        self.window = None if window.scale <= whole.scale * 1.001 else window

    def pan(self, dx: float, dy: float, camera: Camera, screen: tuple[int, int]) -> None:
        """Shift the image by screen pixels."""
        window = self.shown(camera, screen).panned(dx, dy)
        self.window = window.kept_in_sight(camera.size, screen)

    def resized(self, camera: Camera, old: tuple[int, int], new: tuple[int, int]) -> None:
        """The drawing area has another size: its middle still shows the same."""
        if self.window is None:
            return
        ratio = ImageWindow.fit(camera.size, new).scale / ImageWindow.fit(camera.size, old).scale
        middle = self.window.to_image((old[0] / 2, old[1] / 2))
        scaled = replace(self.window, scale=self.window.scale * ratio)
        x, y = scaled.to_screen(middle)
        self.window = scaled.panned(new[0] / 2 - float(x), new[1] / 2 - float(y))

    # --- in the cloud ---------------------------------------------------------------------------

    def orbit(self, T_ref_cam: SE3, pivot: Array, up: Array, yaw: float, pitch: float) -> None:
        """Go around a point.

        Args:
            pivot: (3,) eye coordinates.
            up: (3,) eye coordinates: the axis of `yaw`.
            yaw, pitch: radians; positive turns the scene to the right and down.
        """
        T_eye_ref = self._freed(T_ref_cam)
        R = so3_exp(np.array([-pitch, 0.0, 0.0])) @ so3_exp(yaw * up / np.linalg.norm(up))
        self.T_eye_ref = SE3(R, pivot - R @ pivot) @ T_eye_ref

    def shift(self, T_ref_cam: SE3, by: Array) -> None:
        """Move the scene by `by` (3,) metres in eye coordinates."""
        self.T_eye_ref = SE3(np.eye(3), by) @ self._freed(T_ref_cam)

    def approach(self, T_ref_cam: SE3, point: Array, factor: float) -> None:
        """Go towards a point (3,) of eye coordinates until it is `factor` times as large."""
        distance = float(np.clip(point[2] / factor, NEAREST_M, FARTHEST_M))
        self.shift(T_ref_cam, point * (distance / point[2] - 1.0))

    def _freed(self, T_ref_cam: SE3) -> SE3:
        return T_ref_cam.inverse() if self.T_eye_ref is None else self.T_eye_ref
