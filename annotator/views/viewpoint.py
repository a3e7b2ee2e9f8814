"""Eye of a view, and the geometry between scene, eye and screen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from annotator.app.controller import Controller
from annotator.app.view_options import Mode
from annotator.views.projection import ImageWindow, ScreenCamera
from std_toolkit.geometry import SE3, Camera, so3_exp

# Smallest and largest distance of the eye to the point that it orbits.
NEAREST_M, FARTHEST_M = 0.03, 20.0

Array = NDArray[np.float64]


class Eye:
    """Eye of one view.

    Zooming and panning of image and cloud share one window, so that switching between them keeps
    the screen position of every object.

    Attributes:
        window: part of the image shown; None for all of it.
        T_eye_ref: reference frame to the eye in the cloud; None while the eye is in the frame's
            camera.
    """

    def __init__(self) -> None:
        self.window: ImageWindow | None = None
        self.T_eye_ref: SE3 | None = None

    def shown(self, camera: Camera, screen: tuple[int, int]) -> ImageWindow:
        """The visible part of the image."""
        if self.window is None:
            return ImageWindow.fit(camera.size, screen)
        return self.window

    def screen_camera(self, camera: Camera, screen: tuple[int, int]) -> ScreenCamera:
        return self.shown(camera, screen).screen_camera(camera, screen)

    def T_eye_cam(self, T_ref_cam: SE3) -> SE3:
        """Return the pose of the frame's camera in eye coordinates."""
        return SE3.identity() if self.T_eye_ref is None else self.T_eye_ref @ T_ref_cam

    def fit(self) -> None:
        """Reset to the whole image from the frame's camera."""
        self.window = None
        self.T_eye_ref = None

    def look_at(self, uv: ArrayLike, reach: float, screen: tuple[int, int]) -> None:
        """Zoom to the image position `uv` with `reach` pixels around it."""
        self.window = ImageWindow.around(uv, reach, screen)

    def zoom(self, factor: float, at: ArrayLike, camera: Camera, screen: tuple[int, int]) -> None:
        """Magnify the image; the point at the screen position `at` stays there."""
        window = self.shown(camera, screen).zoomed(factor, at)
        window = window.kept_in_sight(camera.size, screen)
        whole = ImageWindow.fit(camera.size, screen)
        # Zooming out ends with the fitted image, which then follows the window size.
        self.window = None if window.scale <= whole.scale * 1.001 else window

    def pan(self, dx: float, dy: float, camera: Camera, screen: tuple[int, int]) -> None:
        """Pan the image by screen pixels."""
        window = self.shown(camera, screen).panned(dx, dy)
        self.window = window.kept_in_sight(camera.size, screen)

    def resized(self, camera: Camera, old: tuple[int, int], new: tuple[int, int]) -> None:
        """Adapt to a new size of the drawing area; its centre shows the same point."""
        if self.window is None:
            return
        ratio = ImageWindow.fit(camera.size, new).scale / ImageWindow.fit(camera.size, old).scale
        middle = self.window.to_image((old[0] / 2, old[1] / 2))
        scaled = replace(self.window, scale=self.window.scale * ratio)
        x, y = scaled.to_screen(middle)
        self.window = scaled.panned(new[0] / 2 - float(x), new[1] / 2 - float(y))

    # --- in the cloud ---------------------------------------------------------------------------

    def orbit(self, T_ref_cam: SE3, pivot: Array, up: Array, yaw: float, pitch: float) -> None:
        """Orbit a point.

        Args:
            pivot: (3,) eye coordinates.
            up: (3,) eye coordinates: the axis of `yaw`.
            yaw, pitch: radians; positive rotates the scene to the right and down.
        """
        T_eye_ref = self._freed(T_ref_cam)
        R = so3_exp(np.array([-pitch, 0.0, 0.0])) @ so3_exp(yaw * up / np.linalg.norm(up))
        self.T_eye_ref = SE3(R, pivot - R @ pivot) @ T_eye_ref

    def shift(self, T_ref_cam: SE3, by: Array) -> None:
        """Move the scene by `by` (3,) metres in eye coordinates."""
        self.T_eye_ref = SE3(np.eye(3), by) @ self._freed(T_ref_cam)

    def approach(self, T_ref_cam: SE3, point: Array, factor: float) -> None:
        """Approach a point (3,) in eye coordinates until it appears `factor` times as large."""
        distance = float(np.clip(point[2] / factor, NEAREST_M, FARTHEST_M))
        self.shift(T_ref_cam, point * (distance / point[2] - 1.0))

    def _freed(self, T_ref_cam: SE3) -> SE3:
        return T_ref_cam.inverse() if self.T_eye_ref is None else self.T_eye_ref


class Viewpoint:
    """Geometry of one of the controller's views.

    Attributes:
        slot: index of the view; 0 is the main one.
        eye: eye of the view.
        size: width and height of the drawing area in physical pixels.
    """

    def __init__(self, controller: Controller, *, slot: int, size: tuple[int, int]) -> None:
        self.controller = controller
        self.slot = slot
        self.eye = Eye()
        self.size = size
        self._in_world = True

    @property
    def frame(self) -> int:
        """Id of the frame shown."""
        return self.controller.view_frames[self.slot]

    @property
    def mode(self) -> Mode:
        """Mode of the view; side views always show the image."""
        return self.controller.mode if self.slot == 0 else Mode.IMAGE

    @property
    def recorded_camera(self) -> Camera:
        """Camera of the recorded frame, with distortion."""
        scene = self.controller.session.scene
        return scene.camera(scene.frame(self.frame))

    @property
    def camera(self) -> Camera:
        """Camera of the displayed image, without distortion."""
        return self.recorded_camera.without_distortion()

    @property
    def window(self) -> ImageWindow:
        """The visible part of the image."""
        return self.eye.shown(self.camera, self.size)

    @property
    def screen(self) -> ScreenCamera:
        """The pinhole of the drawing area."""
        return self.window.screen_camera(self.camera, self.size)

    @property
    def T_ref_cam(self) -> SE3:
        """Pose of the frame's camera in the reference frame: the world, or the camera itself."""
        T_world_cam = self.controller.session.T_world_cam(self.frame)
        return SE3.identity() if T_world_cam is None else T_world_cam

    @property
    def T_eye_cam(self) -> SE3:
        """Camera coordinates of the frame to eye coordinates."""
        return SE3.identity() if self.mode is Mode.IMAGE else self.eye.T_eye_cam(self.T_ref_cam)

    @property
    def T_eye_world(self) -> SE3 | None:
        """World to eye coordinates; None if the frame has no metric camera pose."""
        T_world_cam = self.controller.session.T_world_cam(self.frame)
        return None if T_world_cam is None else self.T_eye_cam @ T_world_cam.inverse()

    def T_eye_obj(self, name: str) -> SE3 | None:
        """Return the pose of an object as drawn; None if it has none in this frame."""
        T_cam_obj = self.controller.pose(name, self.frame)
        return None if T_cam_obj is None else self.T_eye_cam @ T_cam_obj

    def T_eye_of(self, frame_name: str) -> SE3 | None:
        """Return the transform of "world" or "camera 12" to eye coordinates; None if unknown."""
        T_cam = self.controller.session.T_cam_of(self.frame, frame_name)
        return None if T_cam is None else self.T_eye_cam @ T_cam

    def up(self) -> Array:
        """Up direction (3,), eye coordinates: the table normal, or up in the frame's image."""
        return self.T_eye_cam.R @ self.controller.up(self.frame)

    def settle_reference(self) -> None:
        """Reset the eye to the camera if its reference frame no longer exists.

        This happens when switching between frames with and without a camera pose.
        """
        in_world = self.controller.session.T_world_cam(self.frame) is not None
        if in_world != self._in_world:
            self._in_world = in_world
            self.eye.T_eye_ref = None

    def resize(self, size: tuple[int, int]) -> None:
        """Set the size of the drawing area."""
        if size != self.size:
            self.eye.resized(self.camera, self.size, size)
            self.size = size

    def recorded_pixel(self, xy: Array) -> tuple[float, float]:
        """Return the pixel of the recorded image, with lens distortion, at a screen position."""
        uv = self.window.to_image(xy)
        if self.recorded_camera.is_distorted:
            uv = self.recorded_camera.project(self.camera.unproject(uv))
        return float(uv[0]), float(uv[1])

    def screen_of_recorded(self, uv: Array) -> Array:
        """Return screen positions (N, 2) of pixels (N, 2) of the recorded image."""
        if self.recorded_camera.is_distorted:
            uv = self.camera.project(self.recorded_camera.unproject(uv))
        return self.window.to_screen(uv)
