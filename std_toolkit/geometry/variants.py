"""Symmetric variants: which of the poses that look the same is nearest to another pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.pose_error import mssd
from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.symmetry import Symmetry

Array = NDArray[np.float64]

__all__ = ["common_symmetry", "fixed_point", "nearest_variant"]


def nearest_variant(
    T: SE3, reference: SE3, points: NDArray[np.floating], symmetry: Symmetry
) -> SE3:
    """The pose `T @ S`, S a symmetry of the object, that lies nearest to `reference`.

    Nearest in the sum of squared distances of the points. For a continuous symmetry the best angle
    is known in closed form: a point that turns about an axis moves on a circle, so the sum is
    A cos + B sin + C of the angle.

    Args:
        T, reference: two poses of one object into the same frame.
        points: (P, 3) points on the object (hull vertices), mesh frame, metres.
        symmetry: of the object, mesh frame.
    """
    X = np.asarray(points, dtype=np.float64)
    target = reference @ X
    best, smallest = T, np.inf
    for D in symmetry.discrete_transforms():
        base = T @ D
        candidates = [base]
        if symmetry.is_spherical:
            # Every orientation looks the same: take the reference's, about the sphere's centre.
            centre = np.asarray(symmetry.continuous[0][1], dtype=np.float64)
            candidates = [SE3(reference.R, base @ centre - reference.R @ centre)]
        else:
            candidates += [
                base @ symmetry.turn(i, _best_angle(base, target, X, symmetry, i))
                for i in range(len(symmetry.continuous))
            ]
        for candidate in candidates:
            apart = float(((candidate @ X - target) ** 2).sum())
            if apart < smallest:
                best, smallest = candidate, apart
    return best


def fixed_point(symmetry: Symmetry, point: NDArray[np.floating]) -> Array:
    """(3,) the place that no symmetry moves, nearest to `point`: the mean of its images.

    For the centre of an object's bounding box this is nearly always the centre itself. A distance
    between two poses measured there does not depend on which symmetric variants they are.
    """
    if symmetry.is_spherical:
        return np.asarray(symmetry.continuous[0][1], dtype=np.float64)
    images = np.stack([S @ np.asarray(point, dtype=np.float64) for S in symmetry.transforms()])
    return np.asarray(images.mean(axis=0))


def common_symmetry(a: Symmetry, b: Symmetry, points: NDArray[np.floating]) -> Symmetry:
    """The symmetries that both hold, to a thousandth of the object's size.

    Args:
        points: (P, 3) points on the object, mesh frame, metres.
    """
    if a == b:
        return a
    X = np.asarray(points, dtype=np.float64)
    tolerance = 1e-3 * float(np.ptp(X, axis=0).max())

    def holds(S: SE3, symmetry: Symmetry) -> bool:
        return mssd(S, SE3.identity(), X, symmetry, steps=72) < tolerance

    def turns(symmetry: Symmetry, index: int, other: Symmetry) -> bool:
        # Two angles that no finite group of practical order holds together.
        return all(holds(symmetry.turn(index, angle), other) for angle in (1.0, 2.4))

    identity = SE3.identity()
    discrete = [
        T
        for one, other in ((a, b), (b, a))
        for T in one.discrete
        if holds(SE3.from_matrix(T), other) and mssd(SE3.from_matrix(T), identity, X) >= tolerance
    ]
    continuous = [
        axis
        for one, other in ((a, b), (b, a))
        for i, axis in enumerate(one.continuous)
        if turns(one, i, other)
    ]
    return Symmetry(tuple(dict.fromkeys(discrete)), tuple(dict.fromkeys(continuous)))


def _best_angle(base: SE3, target: Array, X: Array, symmetry: Symmetry, index: int) -> float:
    axis, offset = (np.asarray(v, dtype=np.float64) for v in symmetry.continuous[index])
    axis = axis / np.linalg.norm(axis)
    arm = X - offset
    arm = arm - np.outer(arm @ axis, axis)
    wanted = base.inverse() @ target - offset
    cosine = float((arm * wanted).sum())
    sine = float((np.cross(axis, arm) * wanted).sum())
    return float(np.arctan2(sine, cosine))
