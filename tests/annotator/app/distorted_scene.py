"""A scene seen through a strongly distorting lens, whose every pixel tells its viewing ray."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scene_on_disk import write_frames

from std_toolkit.geometry import Camera
from std_toolkit.scene import CameraModel, Scene, SceneInfo

LENS = Camera(96, 72, 90.0, 90.0, 47.5, 35.5, (-0.25, 0.08, 1e-3, -5e-4))


def colour_of_rays(camera: Camera) -> NDArray[np.float64]:
    """(H, W, 3) grey levels that rise with the viewing ray's slopes."""
    x, y = np.moveaxis(camera.rays()[..., :2], -1, 0)
    return np.stack([128 + 180 * x, 128 + 200 * y, 128 + 90 * (x + y)], axis=-1)


def write_distorted_scene(root: Path, *, frames: int = 2) -> Scene:
    images = [np.rint(colour_of_rays(LENS)).astype(np.uint8)] * frames
    info = SceneInfo(name="lens", cameras={"color": CameraModel.of(LENS)})
    return Scene.create(root, info, write_frames(root, images))
