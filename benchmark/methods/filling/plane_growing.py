"""Planes of a depth image, found by growing regions of square cells.

A plane is affine in the inverse depth: 1/z = a x + b y + c for the ray (x, y, 1). So a fit is
linear least squares over sums that add up when regions merge, and no random numbers are needed.
All tolerances are relative to the depth, so that the unit of depth does not matter.

After Feng, Taguchi, Kamat: Fast plane extraction in organized point clouds using agglomerative
hierarchical clustering. ICRA 2014 (cells as the nodes, sums as their state), grown from the
flattest cell instead of merged pairwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FILLED_CELL = 0.6  # share of a cell's pixels that must be measured
LARGEST_COUNT = 64  # of planes; scenes with more have no planes worth the name


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
