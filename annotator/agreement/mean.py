"""The mean of several poses of one object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Symmetry
from std_toolkit.geometry.se3 import skew
from std_toolkit.geometry.variants import nearest_variant

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MeanPose:
    """A mean and how well it is known.

    Attributes:
        pose: in the frame of the poses.
        covariance: (6, 6) of a right perturbation `pose @ SE3.exp(xi)`; None if that of a pose is
            unknown.
    """

    pose: SE3
    covariance: Array | None


def mean_pose(
    poses: Sequence[SE3],
    points: NDArray[np.floating],
    symmetry: Symmetry,
    covariances: Sequence[NDArray[np.floating] | None] = (),
) -> MeanPose:
    """The pose in the middle of several, on SE(3).

    It is where the twists to all poses cancel; for two poses that is half-way along the screw that
    leads from one to the other, wherever the mesh frame has its origin. If all covariances are
    known, they are the weights. Annotators look at the same images, so their errors are not
    independent, and nobody knows how far: the covariance is that of covariance intersection with
    equal weights, which claims no more than the poses know together in the worst case.

    Source: S. Julier, J. Uhlmann, "A non-divergent estimation algorithm in the presence of unknown
    correlations", American Control Conference 1997.

    Args:
        poses: at least one; the symmetric variant of the first one is kept.
        points: (P, 3) hull vertices of the mesh, mesh frame, metres: they decide which symmetric
            variants belong together.
        symmetry: of the object.
        covariances: one per pose: (6, 6) of right perturbations, or None.

    Raises:
        ToolkitError: no poses.
    """
    if not poses:
        raise ToolkitError("no poses to take the mean of")
    variants = [poses[0], *(nearest_variant(T, poses[0], points, symmetry) for T in poses[1:])]
    known = [
        _carried(np.asarray(c, dtype=np.float64), T, V)
        for c, T, V in zip(covariances, poses, variants, strict=bool(covariances))
        if c is not None and _is_positive(np.asarray(c, dtype=np.float64))
    ]
    weighted = len(known) == len(poses)
    weights = [np.linalg.inv(c) for c in known] if weighted else [np.eye(6)] * len(poses)
    total = np.sum(weights, axis=0)
    mean = variants[0]
    for _ in range(50):
        twists = [(mean.inverse() @ V).log() for V in variants]
        step = np.linalg.solve(
            total, np.sum([W @ x for W, x in zip(weights, twists, strict=True)], axis=0)
        )
        if np.linalg.norm(step) < 1e-13:
            break
        mean = mean @ SE3.exp(step)
    return MeanPose(mean, len(poses) * np.linalg.inv(total) if weighted else None)


def _carried(covariance: Array, T: SE3, variant: SE3) -> Array:
    """Covariance of `variant = T @ S` from that of T: T exp(xi) S = T S exp(Ad(S^-1) xi)."""
    back = variant.inverse() @ T
    adjoint = np.block([[back.R, skew(back.t) @ back.R], [np.zeros((3, 3)), back.R]])
    return np.asarray(adjoint @ covariance @ adjoint.T)


def _is_positive(covariance: Array) -> bool:
    return bool(np.linalg.eigvalsh((covariance + covariance.T) / 2).min() > 0)
