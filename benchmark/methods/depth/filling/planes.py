"""Plane-aware filling: planes from region growing are continued into holes.

A plane is affine in the inverse depth: 1/z = a x + b y + c for the ray (x, y, 1). A fit is linear
least squares over sums that add up when regions merge, without random numbers. All tolerances are
relative to the depth, so the unit of depth does not matter.

After Feng, Taguchi, Kamat: Fast plane extraction in organized point clouds using agglomerative
hierarchical clustering. ICRA 2014 (square cells as nodes, sums as their state), but grown from the
flattest cell instead of merged pairwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.methods.depth.filling.colorization import spread_depth
from benchmark.methods.depth.filling.filler import Filler, FillSettings, check_range, fill_nearest
from std_toolkit.geometry.camera import Camera, pixel_rays

Array = NDArray[np.float64]

FILLED_CELL = 0.6  # share of a cell's pixels that must be measured

LARGEST_COUNT = 64  # of planes; scenes with more have no planes worth the name

CELLS_ACROSS = 64  # an image's width, unless the setting says otherwise

# Standard deviation of the blur of the colours before they are flooded: noise makes edges ragged.
BLUR_PX = 1.5

OTHER, FIRST_PLANE = 1, 2  # markers of the flooding; 0 is to be flooded


@dataclass(frozen=True)
class Plane:
    """A plane and how well it is known.

    Attributes:
        inverse_depth: (3,) a, b, c of 1/z = a x + b y + c, in 1/m.
        covariance: (3, 3) of them, under the assumption that a cell's errors are alike and those
            of different cells independent.
        inliers: (h, w) bool measured pixels on it.
    """

    inverse_depth: Array
    covariance: Array
    inliers: NDArray[np.bool_]


@dataclass(frozen=True)
class _Sums:
    """Normal equations of cells: A (..., 3, 3), b (..., 3), sum of squares and count (...)."""

    A: Array
    b: Array
    square: Array
    count: Array

    def over(self, cells: NDArray[np.bool_]) -> _Sums:
        return _Sums(
            self.A[cells].sum(axis=0),
            self.b[cells].sum(axis=0),
            self.square[cells].sum(axis=0),
            self.count[cells].sum(axis=0),
        )

    def error(self, plane: Array) -> Array:
        """Root mean square, in 1/m, of the cells about a plane (..., 3)."""
        fitted = np.einsum("...ij,...j->...i", self.A, plane) - 2 * self.b
        square = self.square + np.einsum("...i,...i->...", plane, fitted)
        return np.asarray(np.sqrt(np.maximum(square, 0) / np.maximum(self.count, 1)))


def grow_planes(
    depth: NDArray[np.floating],
    rays: Array,
    *,
    cell_px: int,
    tolerance: float,
    least_cells: int,
) -> list[Plane]:
    """The planes of a depth image, those of the flattest cells first.

    Args:
        depth: (h, w) metres, 0 where nothing was measured.
        rays: (h, w, 3) points at z = 1 behind the pixels.
        cell_px: side of the cells.
        tolerance: root-mean-square error of a cell of a plane, relative to its depth. A pixel
            counts as on the plane up to twice that.
        least_cells: smallest number of cells of a plane.
    """
    measured = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=measured)
    sums = _cell_sums(inverse, rays, measured, cell_px)
    mean = np.divide(sums.b[..., 2], sums.count, out=np.ones_like(sums.count), where=sums.count > 0)
    filled = sums.count >= FILLED_CELL * cell_px**2
    own = np.zeros(sums.b.shape)
    own[filled] = np.linalg.solve(sums.A[filled], sums.b[filled][..., None])[..., 0]
    flatness = np.where(filled, sums.error(own) / mean, np.inf)
    free = flatness < tolerance
    planes: list[Plane] = []
    labelled = np.zeros(depth.shape, dtype=bool)
    for seed in np.argsort(flatness, axis=None, kind="stable"):
        at = np.unravel_index(seed, flatness.shape)
        if not np.isfinite(flatness[at]) or len(planes) == LARGEST_COUNT:
            break
        if not free[at]:
            continue
        region, plane = _grown(sums, mean, free, at, own[at], tolerance)
        free &= ~region
        free[at] = False
        if region.sum() < least_cells:
            continue
        found = _refined(inverse, rays, measured & ~labelled, region, plane, cell_px, tolerance)
        labelled |= found.inliers
        planes.append(found)
    return planes


def _cell_sums(inverse: Array, rays: Array, measured: NDArray[np.bool_], size: int) -> _Sums:
    features = rays * measured[..., None]
    rows, columns = -(-inverse.shape[0] // size), -(-inverse.shape[1] // size)

    def cells(values: Array) -> Array:
        padded = np.zeros((rows * size, columns * size))
        padded[: values.shape[0], : values.shape[1]] = values
        return padded.reshape(rows, size, columns, size).sum(axis=(1, 3))

    A = np.empty((rows, columns, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            A[..., i, j] = A[..., j, i] = cells(features[..., i] * rays[..., j])
    b = np.stack([cells(features[..., i] * inverse) for i in range(3)], axis=-1)
    return _Sums(A, b, cells(inverse**2), A[..., 2, 2].copy())


def _grown(
    sums: _Sums,
    mean: Array,
    free: NDArray[np.bool_],
    at: tuple[np.intp, ...],
    plane: Array,
    tolerance: float,
) -> tuple[NDArray[np.bool_], Array]:
    """The cells that a plane reaches from a seed, and the plane through all of them."""
    region = np.zeros(free.shape, dtype=bool)
    region[at] = True
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    while True:
        rim = cv2.dilate(region.astype(np.uint8), cross).astype(bool) & ~region & free
        where = np.nonzero(rim)
        near = _Sums(sums.A[where], sums.b[where], sums.square[where], sums.count[where])
        joins = near.error(plane) < tolerance * mean[where]
        if not joins.any():
            return region, plane
        region[where[0][joins], where[1][joins]] = True
        total = sums.over(region)
        plane = np.asarray(np.linalg.solve(total.A, total.b), dtype=np.float64)


def _refined(
    inverse: Array,
    rays: Array,
    candidates: NDArray[np.bool_],
    region: NDArray[np.bool_],
    plane: Array,
    size: int,
    tolerance: float,
) -> Plane:
    """The plane through the single pixels near it, in its cells and those beside them."""
    wider = cv2.dilate(region.astype(np.uint8), np.ones((3, 3), np.uint8))
    height, width = inverse.shape
    near = np.kron(wider, np.ones((size, size), np.uint8))[:height, :width].astype(bool)
    rows, columns = np.nonzero(near & candidates)
    features, values = rays[rows, columns], inverse[rows, columns]
    for _ in range(2):
        on = np.abs(values - features @ plane) < 2 * tolerance * values
        if on.sum() < size**2:
            break
        fit = np.linalg.lstsq(features[on], values[on], rcond=None)[0]
        plane = np.asarray(fit, dtype=np.float64)
    residual = values - features @ plane
    on = np.abs(residual) < 2 * tolerance * values
    inliers = np.zeros(inverse.shape, dtype=bool)
    inliers[rows[on], columns[on]] = True
    normal = features[on].T @ features[on]
    # A sensor's errors are alike over a cell's width: a cell is one observation, not size**2.
    spread = residual[on].var() * size**2 if on.any() else 0.0
    return Plane(plane, np.linalg.pinv(normal, hermitian=True) * spread, inliers)


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
