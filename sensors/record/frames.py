"""What comes from a camera: its calibration, and sets of images taken at one time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.scene.model import CameraModel

Image8 = NDArray[np.uint8]
Units = NDArray[np.uint16]


@dataclass(frozen=True)
class DeviceInfo:
    """Who made the images; empty where the device does not tell."""

    name: str = ""
    serial: str = ""
    firmware: str = ""
    product_line: str = ""
    usb: str = ""


@dataclass(frozen=True)
class Calibration:
    """What the camera knows about itself.

    Attributes:
        color, depth: intrinsics of the two streams as they are recorded.
        T_color_depth: depth's frame (the left infrared camera's) into the colour camera's.
        depth_unit_m: metres per unit of the depth image.
        baseline_m: from the left infrared camera to the right one, or None.
        infrared: intrinsics of the infrared streams, or None where they are not recorded.
        notes: what had to be converted, for people.
    """

    color: CameraModel
    depth: CameraModel
    T_color_depth: SE3
    depth_unit_m: float
    baseline_m: float | None = None
    infrared: CameraModel | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class CapturedFrame:
    """Images taken at one time.

    Attributes:
        color: (H, W, 3) RGB.
        depth: (h, w) units, 0 = none, in the depth camera.
        aligned: (H, W) units in the colour camera, where the camera's software aligned it.
        infrared: left and right (h, w), as far as they are recorded.
        timestamp: of colour, seconds.
        exposure_s: of colour, or None if the camera does not tell.
    """

    color: Image8
    depth: Units
    timestamp: float
    aligned: Units | None = None
    infrared: dict[str, Image8] = field(default_factory=dict)
    exposure_s: float | None = None
