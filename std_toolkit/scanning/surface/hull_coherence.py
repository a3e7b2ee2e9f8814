"""Whether a motion between two positions of an object explains the outlines of both.

What lies in the hulls of both positions, the second one moved, fills all outlines only if the
motion is right: with a wrong one, each hull carves what the other needs. This needs no texture and
no depth (silhouette coherence: Hernández, Schmitt and Cipolla, TPAMI 29, 2007).
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from std_toolkit.arrays import Array
from std_toolkit.geometry import SE3
from std_toolkit.scanning.surface.measured_surface import Side

# Photos of each position, rays in each, and places along a ray.
_PHOTOS, _RAYS, _PLACES = 16, 100, 96
# Least and largest distance of the sampled pixels from the outline: deeper in a mask, rays meet any
# hull.
_WITHIN_PX = (1.0, 12.0)
# Larger gaps say no more than this, in metres; errors of masks are about as large as the second.
_MOST_M, _USUAL_M = 0.02, 1e-4
# Steps of the derivatives: metres and radians.
_SMALL = np.array([2e-4] * 3 + [2e-3] * 3)
_STEPS = 15


class HullCoherence:
    """Rays through the outlines of two positions, and the hulls of both.

    Args:
        first: photos of the first position with their hull.
        second: photos of the second position, in their own world.
    """

    def __init__(self, first: Side, second: Side) -> None:
        self._hulls = [(_distance(side), side.grid) for side in (first, second)]
        self._rays = [
            _Rays(side, hull) for side, (hull, _) in zip((first, second), self._hulls, strict=True)
        ]
        low, high = first.grid.box
        self._middle = (low + high) / 2

    def gaps(self, T_first_second: SE3) -> Array:
        """(N,) metres by which each ray misses what is in both hulls; 0 where it meets it."""
        motions = (T_first_second.inverse(), T_first_second)
        found = [
            rays.gaps(grid.at(hull, motion @ rays.points))
            for rays, (hull, grid), motion in zip(
                self._rays, reversed(self._hulls), motions, strict=True
            )
        ]
        return np.minimum(np.concatenate(found), _MOST_M)

    def mean_gap(self, T_first_second: SE3) -> float:
        """Mean of the gaps, metres."""
        return float(self.gaps(T_first_second).mean())

    def fitted(self, T_first_second: SE3) -> SE3:
        """The motion near another one with the least gaps."""
        middle = self._middle

        def moved(x: Array) -> SE3:
            R = Rotation.from_rotvec(x[3:]).as_matrix().astype(np.float64)
            return SE3(R, middle - R @ middle + x[:3]) @ T_first_second

        def residuals(x: Array) -> Array:
            return self.gaps(moved(x)) / _USUAL_M

        def derivatives(x: Array) -> Array:
            ends = [(residuals(x + e), residuals(x - e)) for e in np.diag(_SMALL)]
            return np.stack(
                [(a - b) / (2 * s) for (a, b), s in zip(ends, _SMALL, strict=True)], axis=1
            )

        found = least_squares(
            residuals, np.zeros(6), jac=derivatives, x_scale=10 * _SMALL, loss="cauchy",
            max_nfev=_STEPS,
        )  # fmt: skip
        return moved(np.asarray(found.x, np.float64))


class _Rays:
    """Places along rays through the outline that are in the hull of their own photos, or near."""

    def __init__(self, side: Side, hull: NDArray[np.float32]) -> None:
        rng = np.random.default_rng(0)
        low, high = side.grid.box
        middle, half = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        parts = []
        for view in side.views[:: max(1, len(side.views) // _PHOTOS)]:
            depth = ndimage.distance_transform_edt(view.shown)
            v, u = np.nonzero((depth > _WITHIN_PX[0]) & (depth < _WITHIN_PX[1]))
            chosen = rng.permutation(len(u))[:_RAYS]
            d = view.camera.unproject(np.stack([u[chosen], v[chosen]], axis=1).astype(np.float64))
            d = d / np.linalg.norm(d, axis=1, keepdims=True) @ view.T_world_cam.R.T
            away = float(np.linalg.norm(middle - view.centre))
            along = np.linspace(away - half, away + half, _PLACES)
            parts.append(view.centre + along[None, :, None] * d[:, None])
        places = np.concatenate(parts)
        own = side.grid.at(hull, places.reshape(-1, 3)).reshape(places.shape[:2])
        # A ray beside the hull of its own photos, as through a shadow in the mask, says nothing.
        sure = own.min(axis=1) < 0
        places, own = places[sure], own[sure]
        near = own < 2 * side.grid.step
        self.points = places[near]
        self._own = own[near]
        self._first = np.concatenate([[0], np.cumsum(near.sum(axis=1))[:-1]])

    def gaps(self, other: NDArray[np.float32]) -> Array:
        """(N,) gap of each ray from the distances of the places to the other hull."""
        if not len(self.points):
            return np.zeros(0)
        both = np.maximum(self._own, other)
        return np.maximum(np.minimum.reduceat(both, self._first), 0).astype(np.float64)


def _distance(side: Side) -> NDArray[np.float32]:
    """Signed distance to the hull in metres on its grid, negative inside."""
    inside = side.hull < 0
    away = np.asarray(ndimage.distance_transform_edt(~inside))
    deep = np.asarray(ndimage.distance_transform_edt(inside))
    # The surface is half a voxel from the voxels on both of its sides.
    signed = np.where(inside, 0.5 - deep, away - 0.5) * side.grid.step
    return ndimage.gaussian_filter(signed.astype(np.float32), 0.7)
