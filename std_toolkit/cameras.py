"""Live cameras: the protocol and its registry.

A camera gives colour and depth that are aligned to each other. `sensors` registers `realsense`; for
another camera, name a class in a file: `std-restore live --camera my_camera.py:MyCamera`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.plugins import Registry


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """Images of one time.

    Attributes:
        color: (H, W, 3) uint8 RGB.
        depth: (H, W) float32 metres, z-depth aligned to `color`; 0 where nothing was measured.
        timestamp: seconds, of any origin.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    timestamp: float


@dataclass(frozen=True)
class CameraRequest:
    """Which camera and which images are asked for.

    Attributes:
        serial: of the camera; None for the only one.
        size: (width, height) of the colour images.
        fps: images per second.
        stop: returns True once the program is to end; `frames` then ends.
    """

    serial: str | None = None
    size: tuple[int, int] = (640, 480)
    fps: int = 30
    stop: Callable[[], bool] = lambda: False


class LiveCamera(Protocol):
    """An open camera; made with a `CameraRequest`.

    Attributes:
        name: of the device, for the user.
        camera: intrinsics of the colour images; distortion is allowed.
    """

    name: str
    camera: Camera

    def frames(self) -> Iterator[LiveFrame]:
        """Images in order of time, until the camera ends or is stopped.

        Raises:
            ToolkitError: the camera does not start, or sends nothing any more.
        """
        ...

    def close(self) -> None:
        """Stop the camera; may be called twice."""
        ...


CAMERAS: Registry[Callable[[CameraRequest], LiveCamera]] = Registry("std_toolkit.cameras", {})
