"""Similarity transforms between corresponding point sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Similarity:
    """`p_a = scale * R @ p_b + t`.

    Attributes:
        scale: positive factor.
        R: (3, 3) rotation.
        t: (3,) translation in units of frame a.
    """

    scale: float
    R: Array
    t: Array

    def __matmul__(self, points: NDArray[np.floating]) -> Array:
        """Transform points (..., 3)."""
        return self.scale * (np.asarray(points) @ self.R.T) + self.t

    def inverse(self) -> Similarity:
        return Similarity(1 / self.scale, self.R.T, -self.R.T @ self.t / self.scale)

    def matrix(self) -> Array:
        """(4, 4) matrix that includes the scale, as NOCS-style evaluations store it."""
        M = np.eye(4)
        M[:3, :3] = self.scale * self.R
        M[:3, 3] = self.t
        return M

    def transform_pose(self, T_b_cam: SE3) -> SE3:
        """Convert a camera pose from frame b to frame a: rotated, translated and scaled."""
        return SE3(self.R @ T_b_cam.R, self @ T_b_cam.t)


def umeyama(
    src: NDArray[np.floating],
    dst: NDArray[np.floating],
    *,
    with_scale: bool = True,
    weights: NDArray[np.floating] | None = None,
) -> Similarity:
    """Least-squares similarity that maps src (N, 3) onto dst (N, 3).

    Source: S. Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", PAMI 1991, equations 40-42.

    Args:
        src, dst: corresponding points.
        with_scale: estimate the scale; otherwise it is 1 (a rigid fit).
        weights: (N,) non-negative weights.

    Raises:
        ToolkitError: fewer than three points, values that are not finite, invalid weights, or
            points on a line (the rotation about it is then undetermined).
    """
    p, q = _point_sets(src, dst)
    w = np.ones(len(p)) if weights is None else np.asarray(weights, dtype=np.float64)
    if w.shape != (len(p),) or not (np.isfinite(w).all() and (w >= 0).all() and w.sum() > 0):
        raise ToolkitError("weights must be (N,), finite, not negative, and not all zero")
    w = w / w.sum()
    mean_p, mean_q = w @ p, w @ q
    dp, dq = p - mean_p, q - mean_q
    U, S, Vt = np.linalg.svd((dq * w[:, None]).T @ dp)
    # Rounding errors of large coordinates must not count as extent.
    rounding = 1e-15 * float(np.abs(p).max() * np.abs(q).max())
    if S[1] <= max(1e-12 * S[0], rounding):
        raise ToolkitError("points for a similarity are on a line: the rotation is undetermined")
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = (U * sign) @ Vt
    variance = float(w @ (dp**2).sum(axis=1))
    scale = float((S * sign).sum() / variance) if with_scale else 1.0
    return Similarity(scale, R, mean_q - scale * R @ mean_p)


def ransac_similarity(
    src: NDArray[np.floating],
    dst: NDArray[np.floating],
    *,
    threshold_m: float,
    with_scale: bool = True,
    confidence: float = 0.999,
    max_iterations: int = 1000,
    seed: int = 0,
) -> tuple[Similarity, NDArray[np.bool_]]:
    """Similarity from src to dst in the presence of outliers.

    A correspondence is an inlier if its residual in the units of dst (metres) is below
    `threshold_m`. The NOCS reference implementation derives its threshold from the ratio of the
    mean norms of the two sets; this accepts every point and never rejects an outlier.

    Args:
        src, dst: (N, 3) corresponding points.
        threshold_m: largest residual of an inlier, metres.
        with_scale: estimate the scale as well.
        confidence: stop when an outlier-free sample was drawn with this probability.
        max_iterations: upper bound on the samples drawn.
        seed: seed of the random samples.

    Returns:
        The similarity refitted to all inliers, and the (N,) inlier mask.

    Raises:
        ToolkitError: fewer than three points, values that are not finite, or no similarity with
            three inliers that are not on a line.
    """
    p, q = _point_sets(src, dst)
    if not threshold_m > 0:
        raise ToolkitError("must be positive", field="threshold_m", value=threshold_m)
    rng = np.random.default_rng(seed)
    best = np.zeros(len(p), dtype=bool)
    sample_size = min(4, len(p))
    needed = float(max_iterations)
    iteration = 0
    while iteration < min(needed, max_iterations):
        iteration += 1
        sample = rng.choice(len(p), sample_size, replace=False)
        try:
            model = umeyama(p[sample], q[sample], with_scale=with_scale)
        except ToolkitError:
            continue
        inliers = _residuals(model, p, q) < threshold_m
        if inliers.sum() > best.sum():
            best = inliers
            miss = 1 - inliers.mean() ** sample_size
            needed = np.log(1 - confidence) / np.log(miss) if 0 < miss < 1 else 0.0
    if best.sum() < 3:
        raise ToolkitError(
            "no similarity explains three correspondences",
            value=f"{len(p)} points, threshold {threshold_m} m",
        )
    # Refit until the inlier set is stable; the first fits from 4 noisy points are rough.
    for _ in range(10):
        model = umeyama(p[best], q[best], with_scale=with_scale)
        refined = _residuals(model, p, q) < threshold_m
        if refined.sum() < 3 or (refined == best).all():
            return model, best
        best = refined
    return umeyama(p[best], q[best], with_scale=with_scale), best


def _point_sets(src: NDArray[np.floating], dst: NDArray[np.floating]) -> tuple[Array, Array]:
    p = np.asarray(src, dtype=np.float64)
    q = np.asarray(dst, dtype=np.float64)
    if p.shape != q.shape or p.ndim != 2 or p.shape[1] != 3 or len(p) < 3:
        raise ToolkitError(
            "a similarity needs two equal sets of at least 3 points of shape (N, 3)",
            value=(p.shape, q.shape),
        )
    if not (np.isfinite(p).all() and np.isfinite(q).all()):
        raise ToolkitError("points for a similarity contain numbers that are not finite")
    return p, q


def _residuals(model: Similarity, p: Array, q: Array) -> Array:
    return np.linalg.norm(model @ p - q, axis=1)
