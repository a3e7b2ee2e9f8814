"""Inpainting of depth as if it were a grey picture, by OpenCV."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.methods.filling.filler import Filler
from benchmark.methods.filling.settings import FillSettings, check_range
from std_toolkit.geometry.camera import Camera

# OpenCV inpaints float32, but Telea's method adds terms to each value that are meant for grey
# values of 0 to 255: half a unit, and a normalised gradient of up to sqrt(2). On depth in metres
# these are metres. With the largest depth at this value they are below the precision of a sensor
# (2 in a million), and float32 still has four digits to spare.
LARGEST_GREY = 1e6


@dataclass(frozen=True, kw_only=True)
class InpaintingSettings(FillSettings):
    """Of both inpainting methods.

    Attributes:
        radius_px: how far around a pixel the method looks.
    """

    radius_px: float = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("radius_px", self.radius_px, 1, 100)


class Inpainting(Filler):
    """What `cv2.inpaint` makes of the depth in float32, kept within the range of the measured.

    Both methods go inwards from the rim of a hole and know nothing of colour: they continue
    surfaces and blur edges.
    """

    settings_type = InpaintingSettings
    settings: InpaintingSettings
    flag: ClassVar[int]

    def fill(
        self,
        color: NDArray[np.uint8],  # noqa: ARG002
        depth: NDArray[np.float64],
        missing: NDArray[np.bool_],
        camera: Camera,  # noqa: ARG002
    ) -> NDArray[np.floating]:
        known = depth[~missing]
        nearest, farthest = known.min(), known.max()
        grey = (depth * (LARGEST_GREY / farthest)).astype(np.float32)
        painted = cv2.inpaint(grey, missing.astype(np.uint8), self.settings.radius_px, self.flag)
        # Both extrapolate gradients, in a wide hole beyond all bounds.
        return np.clip(painted * (farthest / LARGEST_GREY), nearest, farthest)


class NavierStokes(Inpainting):
    """Inpainting: isophotes continued into the hole as the flow lines of a fluid.

    Bertalmio, Bertozzi, Sapiro: Navier-Stokes, fluid dynamics, and image and video inpainting.
    CVPR 2001.
    """

    name = "navier-stokes"
    flag = cv2.INPAINT_NS


class Telea(Inpainting):
    """Inpainting: weighted means along the front of a fast marching from the rim of the hole.

    Telea: An image inpainting technique based on the fast marching method. Journal of Graphics
    Tools 9(1), 2004.
    """

    name = "telea"
    flag = cv2.INPAINT_TELEA
