"""The photos of an RGB-D scene: its colour frames, with the depth of the sensor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger
from std_toolkit.poses.features import FrameMeasure, measure_image
from std_toolkit.scanning.photos import Photos, Sensor, photos_of
from std_toolkit.scanning.video import PHOTOS, spread
from std_toolkit.scene import Scene


def is_scene(path: Path) -> bool:
    """Whether a folder is a scene of `std-curate import`."""
    return (path / "scene.json").is_file()


def scene_photos(root: Path, work: Path, *, longest: int) -> Photos:
    """The colour frames of a scene as photos; of many about 60, spread evenly over the motion.

    Args:
        root: folder of the scene.
        work: receives reduced copies.
        longest: longer side of the images that are used, pixels.

    Raises:
        ToolkitError: an unreadable scene, too few frames, or frames of several cameras.
    """
    scene = Scene.open(root)
    cameras = sorted({frame.camera for frame in scene.frames})
    if len(cameras) > 1:
        raise ToolkitError(
            "the scene has several cameras", path=root, value=", ".join(cameras),
            hint="import the frames of one camera",
        )  # fmt: skip
    frames = scene.frames
    if len(frames) > PHOTOS:
        measures: list[FrameMeasure] = []
        previous: NDArray[np.uint8] | None = None
        for frame in frames:
            grey = cv2.cvtColor(scene.read_color(frame), cv2.COLOR_RGB2GRAY)
            measure, previous = measure_image(np.asarray(grey, np.uint8), previous)
            measures.append(measure)
        frames = [frames[i] for i in spread(measures, PHOTOS)]
        logger.info("%s: %d of %d frames are used", root.name, len(frames), len(scene.frames))
    found = photos_of([scene.color_path(f) for f in frames], root, work, longest=longest)
    return replace(found, sensor=Sensor(scene, tuple(frames)))
