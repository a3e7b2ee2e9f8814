"""The axis that a mesh is turned about, as far as its shape tells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# A normal that points so well to the axis (sine) is that of a surface turned about it ...
_ALIGNED = 0.2
# ... and so much of the sides has to be turned: the rest is handles and spouts.
_SHARE = 0.6
# A bowl is part of a ball, which is turned about every axis: its rim is as wide as it is deep, up
# to this ratio.
_RIM = 1.1
_ROUNDS = 8


def round_axis(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> int | None:
    """The coordinate axis (0, 1, 2) about which most of a mesh is turned; None if there is none.

    Bottles, cans, bowls and mugs stand on it, whichever axis their data set calls up. Of several,
    as of a ball, none is told apart: None.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    middles = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    shares = [
        _turned_share(np.delete(middles, axis, axis=1), np.delete(normals, axis, axis=1))
        for axis in range(3)
    ]
    turned = [axis for axis in range(3) if shares[axis] > _SHARE]
    if len(turned) > 1:
        extents = np.ptp(corners.reshape(-1, 3), axis=0)
        rims = [np.delete(extents, axis) for axis in range(3)]
        turned = [axis for axis in turned if rims[axis].max() <= _RIM * rims[axis].min()]
    return turned[0] if len(turned) == 1 else None


def _turned_share(places: Array, normals: Array) -> float:
    """Share of the sides whose normals meet in one point, seen along an axis.

    Args:
        places: (N, 2) middles of the faces.
        normals: (N, 2) their normals times their areas.
    """
    size = np.linalg.norm(normals, axis=1)
    sides = size > 1e-6 * max(float(size.max(initial=0.0)), 1e-30)
    if not sides.any():
        return 0.0
    places, size = places[sides], size[sides]
    across = np.stack([-normals[sides, 1], normals[sides, 0]], axis=1) / size[:, None]
    # across . (place - centre) = 0 for every turned face: least absolute residuals.
    weight = size.copy()
    for _ in range(_ROUNDS):
        system = np.einsum("n,ni,nj->ij", weight, across, across)
        centre = np.linalg.lstsq(
            system, np.einsum("n,ni,nj,nj->i", weight, across, across, places), rcond=None
        )[0]
        missed = np.abs(np.einsum("ni,ni->n", across, places - centre))
        weight = size / np.maximum(missed, 0.01 * max(float(np.median(missed)), 1e-9))
    radius = np.linalg.norm(places - centre, axis=1)
    return float(size[missed <= _ALIGNED * radius].sum() / size.sum())
