"""Inpainting by OpenCV, and joint bilateral filling.

Joint bilateral filling averages measured depth, weighted by distance and colour.
"""

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from benchmark.methods.depth.filling.filler import Filler, FillSettings, check_range
from std_toolkit.geometry.camera import Camera

# OpenCV inpaints float32, but Telea's method adds terms to each value that are meant for grey
# values of 0 to 255: half a unit, and a normalised gradient of up to sqrt(2). On depth in metres
# these are metres. With the largest depth at this value they are below the precision of a sensor
# (2 in a million), and float32 still has four digits to spare.
LARGEST_GREY = 1e6

REACH = 3  # cells that the window reaches to each side

PIXELS_AT_ONCE = 1 << 16  # bounds the memory: 49 weights a pixel

# Standard deviation of the blur of the colours that are compared: noise and fine texture, which
# would pass from the picture into the depth.
BLUR_PX = 1.5


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


@dataclass(frozen=True, kw_only=True)
class JointBilateralSettings(FillSettings):
    """Of joint bilateral filling.

    Attributes:
        color_sigma: difference of colour, in 8-bit levels over the three channels together, at
            which a measurement counts exp(-1/2) of one of the same colour.
        width: standard deviation of the weight in the image, in distances to the nearest
            measurement.
    """

    color_sigma: float = 12.0
    width: float = 0.7

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("color_sigma", self.color_sigma, 0.1, 500)
        check_range("width", self.width, 0.3, 3)


class JointBilateral(Filler):
    """A mean of the measured depth around a pixel, weighted by nearness and likeness of colour.

    Only measured pixels count and the weights are normalised over them. The window is as wide as
    it must be: a pixel deep inside a hole looks farther. So that its cost does not grow with it,
    the window always has 7x7 cells, each with one of its measured pixels (with its own place and
    colour; nothing is averaged across edges before it is weighed).

    Petschnigg et al.: Digital photography with flash and no-flash image pairs. Kopf et al.: Joint
    bilateral upsampling. ACM Transactions on Graphics 23(3), 2004, and 26(3), 2007.
    """

    name = "joint-bilateral"
    settings_type = JointBilateralSettings
    settings: JointBilateralSettings

    def fill(
        self,
        color: NDArray[np.uint8],
        depth: NDArray[np.float64],
        missing: NDArray[np.bool_],
        camera: Camera,  # noqa: ARG002
    ) -> NDArray[np.floating]:
        blurred = cv2.GaussianBlur(color.astype(np.float32), (0, 0), BLUR_PX)
        guide = np.asarray(blurred, dtype=np.float32)
        away = distance_transform_edt(missing)
        # The nearest measurement lies within the window, and as much again beyond it.
        level = np.ceil(np.log2(np.maximum(2 * away / REACH, 1))).astype(int)
        filled = depth.astype(np.float32)
        for number in np.unique(level[missing]):
            cells = _Cells(guide, filled, missing, 1 << int(number))
            rows, columns = np.nonzero(missing & (level == number))
            for start in range(0, len(rows), PIXELS_AT_ONCE):
                at = rows[start : start + PIXELS_AT_ONCE], columns[start : start + PIXELS_AT_ONCE]
                spread = self.settings.width * away[at]
                filled[at] = cells.mean_at(guide, at, spread, self.settings.color_sigma)
        return filled


class _Cells:
    """One measured pixel of each square cell of an image."""

    def __init__(
        self,
        guide: NDArray[np.float32],
        depth: NDArray[np.float32],
        missing: NDArray[np.bool_],
        size: int,
    ) -> None:
        rows, columns = np.nonzero(~missing)
        height, width = -(-missing.shape[0] // size), -(-missing.shape[1] // size)
        # Of the measured pixels of a cell the one in the middle of their order: no side of the
        # cell is preferred, and no random numbers are needed.
        cell = (rows // size) * width + columns // size
        order = np.argsort(cell, kind="stable")
        first = np.flatnonzero(np.diff(cell[order], prepend=-1))
        count = np.diff(np.append(first, len(order)))
        chosen = order[first + count // 2]
        self.size = size
        # A frame of empty cells spares the bounds' checks.
        self.pixel = np.full((height + 2 * REACH, width + 2 * REACH), -1)
        inner = self.pixel[REACH : REACH + height, REACH : REACH + width]
        inner[rows[chosen] // size, columns[chosen] // size] = np.arange(len(chosen))
        self.place = np.stack([rows[chosen], columns[chosen]], axis=-1).astype(np.float32)
        self.color = guide[rows[chosen], columns[chosen]]
        self.depth = depth[rows[chosen], columns[chosen]]

    def mean_at(
        self,
        guide: NDArray[np.float32],
        at: tuple[NDArray[np.intp], NDArray[np.intp]],
        spread: NDArray[np.float64],
        color_sigma: float,
    ) -> NDArray[np.float32]:
        """Weighted mean of the depth of the cells around some pixels."""
        rows, columns = at
        inside = guide[rows, columns]
        around = (2 * spread**2).astype(np.float32)
        log_weight = np.full(((2 * REACH + 1) ** 2, len(rows)), -np.inf, dtype=np.float32)
        values = np.zeros_like(log_weight)
        for k, (dy, dx) in enumerate(np.ndindex(2 * REACH + 1, 2 * REACH + 1)):
            pixel = self.pixel[rows // self.size + dy, columns // self.size + dx]
            there = np.flatnonzero(pixel >= 0)
            pixel = pixel[there]
            place = self.place[pixel]
            apart = (place[:, 0] - rows[there]) ** 2 + (place[:, 1] - columns[there]) ** 2
            unlike = ((self.color[pixel] - inside[there]) ** 2).sum(axis=-1)
            log_weight[k, there] = -apart / around[there] - unlike / (2 * color_sigma**2)
            values[k, there] = self.depth[pixel]
        # Relative to the largest: however unlike all colours are, one measurement counts.
        weight = np.exp(log_weight - log_weight.max(axis=0))
        return np.asarray((weight * values).sum(axis=0) / weight.sum(axis=0))
