"""Finding out whether a shape is turned about its vertical axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sensors.assets.asset import NO_SYMMETRY, TURN_Y
from std_toolkit.geometry.symmetry import Symmetry

_SAMPLES = 2000
# Fractions of a turn that no regular polygon below 17 corners repeats after.
_ANGLES = tuple(2 * np.pi * x for x in (0.093, 0.269, 0.41))
# A facetted cylinder of 16 sides departs from the round one by 2 % of its radius.
_TOLERANCE = 0.012


def turn_symmetry(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, tolerance: float = _TOLERANCE
) -> Symmetry:
    """Full turns about y, if they leave the shape where it was; colours are not looked at.

    Args:
        vertices: (V, 3) canonical.
        faces: (F, 3).
        tolerance: how far the turned surface may lie from itself, as a share of the diagonal; one
            point in a hundred may be further away.
    """
    import open3d as o3d

    corners = np.asarray(vertices, dtype=np.float64)[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if not area.sum() > 0:
        return NO_SYMMETRY
    rng = np.random.default_rng(0)
    face = rng.choice(len(faces), _SAMPLES, p=area / area.sum())
    a, b = np.sort(rng.random((2, _SAMPLES)), axis=0)
    weights = np.stack([a, b - a, 1 - b], axis=1)
    points = np.einsum("nk,nkd->nd", weights, corners[face])
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, dtype=np.float32)),
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32)),
    )
    for angle in _ANGLES:
        c, s = np.cos(angle), np.sin(angle)
        turned = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
        distance = scene.compute_distance(
            o3d.core.Tensor.from_numpy(turned.astype(np.float32))
        ).numpy()
        if np.quantile(distance, 0.99) > tolerance:
            return NO_SYMMETRY
    return TURN_Y
