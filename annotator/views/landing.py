"""Where on a frame's image something lands that is dropped onto a view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from annotator.desk.view_options import Mode
from annotator.views.scene_view import SceneView


def recorded_pixel_under(view: SceneView, xy: NDArray[np.float64]) -> tuple[float, float]:
    """Pixel of the recorded image, lens distortion included, for what is under a screen position.

    Args:
        xy: (2,) physical pixels from the top left corner of the drawing area.
    """
    if view.mode is Mode.IMAGE:
        return view.recorded_pixel(xy)
    seen = view.recorded_camera.project(view.T_eye_cam.inverse() @ view.point_under(xy))
    if not np.isfinite(seen).all():
        # Behind the camera of the frame: the middle of its image.
        camera = view.recorded_camera
        return camera.width / 2, camera.height / 2
    return float(seen[0]), float(seen[1])
