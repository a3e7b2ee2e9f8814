"""Plane-aware filling: holes in tables, walls and boxes continue their planes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.methods.filling.colorization import spread_depth
from benchmark.methods.filling.filler import Filler
from benchmark.methods.filling.nearest import fill_nearest
from benchmark.methods.filling.plane_growing import Plane, grow_planes
from benchmark.methods.filling.settings import FillSettings, check_range
from std_toolkit.geometry.camera import Camera, pixel_rays

CELLS_ACROSS = 64  # an image's width, unless the setting says otherwise
# Standard deviation of the blur of the colours before they are flooded: noise makes edges ragged.
BLUR_PX = 1.5
OTHER, FIRST_PLANE = 1, 2  # markers of the flooding; 0 is to be flooded


@dataclass(frozen=True, kw_only=True)
class PlanesSettings(FillSettings):
    """Of plane-aware filling.

    Attributes:
        cell_px: side of the square cells that planes grow from; 0 for a 64th of the width, at
            least 5.
        tolerance: how far measurements may lie from their plane (root mean square), relative to
            the depth.
        least_cells: smallest number of cells of a plane.
        certainty: a plane is continued as far as its own error (standard deviation) there stays
            below this share of the depth.
    """

    cell_px: int = 0
    tolerance: float = 0.006
    least_cells: int = 8
    certainty: float = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cell_px:
            check_range("cell_px", self.cell_px, 3, 200)
        check_range("tolerance", self.tolerance, 1e-5, 0.2)
        check_range("least_cells", self.least_cells, 1, 10000)
        check_range("certainty", self.certainty, 1e-5, 1)


class Planes(Filler):
    """Continues the planes around a hole into it; what no plane claims is filled by colorization.

    Planes are grown over the measured depth (`plane_growing`). Which plane a missing pixel belongs
    to is decided by flooding the colour image from the measured pixels (watershed), which stops at
    edges of colour. A plane is not continued to where it is uncertain, behind the camera, or far
    outside the range of what was measured.
    """

    name = "planes"
    settings_type = PlanesSettings
    settings: PlanesSettings

    def fill(
        self,
        color: NDArray[np.uint8],
        depth: NDArray[np.float64],
        missing: NDArray[np.bool_],
        camera: Camera,
    ) -> NDArray[np.floating]:
        # Pixels that no ray reaches through the lens become (0, 0, 0), which lies on no plane.
        rays = np.nan_to_num(pixel_rays(camera))
        size = self.settings.cell_px or max(5, round(camera.width / CELLS_ACROSS))
        planes = grow_planes(
            np.where(rays[..., 2] > 0, depth, 0),
            rays,
            cell_px=size,
            tolerance=self.settings.tolerance,
            least_cells=self.settings.least_cells,
        )
        filled = depth.copy()
        left = missing.copy()
        if planes:
            label = _flooded(color, missing, planes, size)
            for number, plane in enumerate(planes, start=FIRST_PLANE):
                at = np.nonzero(missing & (label == number))
                z = self._continued(plane, rays[at], depth)
                filled[at] = z
                left[at] = z == 0
        if left.any():
            filled = spread_depth(color, filled, left)
        return filled

    def _continued(
        self, plane: Plane, rays: NDArray[np.float64], depth: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(n,) depth of a plane behind n pixels, 0 where it says nothing."""
        inverse = rays @ plane.inverse_depth
        error = np.sqrt(np.einsum("ni,ij,nj->n", rays, plane.covariance, rays))
        known = depth[depth > 0]
        # 1/z may be zero or negative: towards the horizon and beyond it.
        sure = (inverse > 0.5 / known.max()) & (inverse < 2 / known.min())
        sure &= error < self.settings.certainty * inverse
        return np.divide(1.0, inverse, out=np.zeros_like(inverse), where=sure)


def _flooded(
    color: NDArray[np.uint8], missing: NDArray[np.bool_], planes: list[Plane], size: int
) -> NDArray[np.int32]:
    """(h, w) label of every pixel: `FIRST_PLANE` and up for the planes, `OTHER` for no plane."""
    markers = np.zeros(missing.shape, dtype=np.int32)
    for number, plane in enumerate(planes, start=FIRST_PLANE):
        markers[plane.inliers] = number
    # The rim of a hole has wild measurements; only what is wide is something other than a plane.
    other = (~missing & (markers == 0)).astype(np.uint8)
    markers[cv2.morphologyEx(other, cv2.MORPH_OPEN, np.ones((size, size), np.uint8)) > 0] = OTHER
    # OpenCV never floods the outermost pixels.
    smooth = cv2.GaussianBlur(color, (0, 0), BLUR_PX)
    framed = cv2.copyMakeBorder(smooth, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    label = np.pad(markers, 1)
    cv2.watershed(framed, label)
    label = label[1:-1, 1:-1]
    return np.asarray(fill_nearest(label, label <= 0), dtype=np.int32)
