"""Pose and size of an object from its NOCS coordinates and its points."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.alignment import Similarity, ransac_similarity, umeyama

Floats = NDArray[np.float64]

# The released evaluation gives up on so few pixels.
_PAPER_LEAST_POINTS = 4

# Tukey's biweight: 95 % efficient on normal errors. The median length of a normal error in space is
# 1.538 standard deviations of a coordinate.
_TUKEY = 4.685
_MEDIAN_LENGTH = 1.538
_LEAST_SCALE_M = 1e-4
_ROUNDS = 20


class FitMethod(Enum):
    """How outliers are met.

    Attributes:
        RANSAC: points farther than a metric threshold from where the pose puts them do not count.
            A last fit weights the others, by Tukey's function at the scale of their errors: what
            two centimetres let pass on a small object is far out there.
        PAPER: least squares over all points. The released code draws samples too, but its threshold
            is the ratio of two mean norms, some metres, which no point exceeds.
    """

    RANSAC = "ransac"
    PAPER = "paper"


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How a pose is fitted.

    Attributes:
        fit: how outliers are met.
        threshold_m: largest distance of an inlier, metres; for RANSAC.
        search_points: the search runs on a choice of so many points, the last fit on all.
        max_iterations: samples drawn at most.
        last: last fit of RANSAC: weighted (`tukey`), or least squares over all inliers.
        seed: of the choice and the samples.

    Raises:
        ToolkitError: a threshold or number that is not positive.
    """

    fit: FitMethod = FitMethod.RANSAC
    threshold_m: float = 0.02
    search_points: int = 2000
    max_iterations: int = 500
    last: Literal["tukey", "inliers"] = "tukey"
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("threshold_m", "search_points", "max_iterations"):
            if not getattr(self, name) > 0:
                raise ToolkitError("must be positive", field=name, value=getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """The settings of a fit that a method's user gives; configurations of methods inherit them.

    Attributes:
        fit: `ransac` or `paper`, see `FitMethod`; `std-bench --fit` sets it.
        threshold_m: largest distance of an inlier, metres; for `ransac`.
        last: last fit of `ransac`: `tukey` or `inliers`, see `FitOptions`.
    """

    fit: Literal["ransac", "paper"] = "ransac"
    threshold_m: float = 0.02
    last: Literal["tukey", "inliers"] = "tukey"

    @property
    def fit_options(self) -> FitOptions:
        """As `fit_pose` takes them.

        Raises:
            ToolkitError: a threshold that is not positive.
        """
        return FitOptions(fit=FitMethod(self.fit), threshold_m=self.threshold_m, last=self.last)


@dataclass(frozen=True, eq=False)
class FittedPose:
    """A box in space.

    Attributes:
        RT: (4, 4) object to camera; the scale inside is the box's diagonal in metres.
        size: (3,) of the box before RT, of length 1.
        inliers: (N,) which points the pose was fitted to.
        diagonal: the box's, in normalised coordinates.
    """

    RT: Floats
    size: Floats
    inliers: NDArray[np.bool_]
    diagonal: float = 1.0

    def with_sides(self, sides: Floats) -> FittedPose:
        """The same pose with another box.

        Args:
            sides: (3,) of the box in normalised coordinates.

        >>> box = np.array([[x, y, z] for x in (-0.4, 0.4) for y in (-0.3, 0.3) for z in (0, 0.1)])
        >>> found = fit_pose(box, 0.2 * box + np.array([0.0, 0.0, 1.0]))
        >>> found.with_sides(np.array([0.0, 0.0, 2.0])).RT[2, 2].round(6).item()
        0.4
        """
        diagonal = float(np.linalg.norm(sides))
        RT = self.RT.copy()
        RT[:3, :3] *= diagonal / self.diagonal
        return FittedPose(RT, np.asarray(sides) / diagonal, self.inliers, diagonal)


def fit_pose(
    coordinates: NDArray[np.floating],
    points: NDArray[np.floating],
    options: FitOptions | None = None,
) -> FittedPose:
    """Fit a box's pose and size.

    The box is as wide along each axis as twice its farthest coordinate from the middle, of the
    points that count.

    Args:
        coordinates: (N, 3) normalised coordinates of an object's pixels, the middle at 0 (NOCS
            maps hold them plus 0.5).
        points: (N, 3) where these pixels are in the camera frame, metres.
        options: how outliers are met.

    Returns:
        The box. `FitMethod.PAPER` answers what cannot be fitted with the identity, as the released
        code does, so that the prediction is there and wrong.

    Raises:
        ToolkitError: shapes that do not belong together, numbers that are not finite, or, for
            RANSAC, points that no pose explains.

    >>> box = np.array([[x, y, z] for x in (-0.4, 0.4) for y in (-0.3, 0.3) for z in (0.0, 0.1)])
    >>> found = fit_pose(box, 0.2 * box + np.array([0.0, 0.0, 1.0]))
    >>> found.RT[2, 2:].round(6).tolist(), found.size.round(3).tolist()
    ([0.203961, 1.0], [0.784, 0.588, 0.196])
    """
    options = options or FitOptions()
    c, p = np.asarray(coordinates, dtype=np.float64), np.asarray(points, dtype=np.float64)
    if c.shape != p.shape or c.ndim != 2 or c.shape[1] != 3:
        raise ToolkitError("needs two equal arrays (N, 3)", value=(c.shape, p.shape))
    if not (np.isfinite(c).all() and np.isfinite(p).all()):
        raise ToolkitError("coordinates or points are not finite")
    if options.fit is FitMethod.PAPER:
        return _least_squares(c, p)
    rng = np.random.default_rng(options.seed)
    some = rng.permutation(len(c))[: options.search_points]
    found, _ = ransac_similarity(
        c[some],
        p[some],
        threshold_m=options.threshold_m,
        max_iterations=options.max_iterations,
        seed=options.seed,
    )
    inliers = np.linalg.norm(found @ c - p, axis=1) < options.threshold_m
    found = umeyama(c[inliers], p[inliers])
    if options.last == "tukey":
        found, inliers = _weighted(found, c, p, options.threshold_m)
    return _box(found.matrix(), c, inliers)


def _weighted(
    found: Similarity, c: Floats, p: Floats, threshold_m: float
) -> tuple[Similarity, NDArray[np.bool_]]:
    """The fit whose points are weighted by Tukey's function, and its inliers."""
    for _ in range(_ROUNDS):
        apart = np.linalg.norm(found @ c - p, axis=1)
        near = apart < threshold_m
        if near.sum() < _PAPER_LEAST_POINTS:
            break
        scale = max(float(np.median(apart[near])) / _MEDIAN_LENGTH, _LEAST_SCALE_M)
        reach = min(_TUKEY * scale, threshold_m)
        weights = np.clip(1 - (apart / reach) ** 2, 0, None) ** 2
        try:
            better = umeyama(c, p, weights=weights)
        except ToolkitError:  # too few are left, or they are on a line
            break
        moved = float(np.abs(better.matrix() - found.matrix()).max())
        found = better
        if moved < 1e-9:
            break
    return found, np.linalg.norm(found @ c - p, axis=1) < threshold_m


def _least_squares(c: Floats, p: Floats) -> FittedPose:
    everything = np.ones(len(c), dtype=bool)
    nothing = np.eye(4), np.full(3, 1 / np.sqrt(3))
    if len(c) < _PAPER_LEAST_POINTS:
        return FittedPose(*nothing, ~everything)
    try:
        return _box(umeyama(c, p).matrix(), c, everything)
    except ToolkitError:
        return FittedPose(*nothing, ~everything)


def _box(RT: Floats, c: Floats, inliers: NDArray[np.bool_]) -> FittedPose:
    """Move the length of the box's diagonal from its size into the pose."""
    extent = 2 * np.abs(c[inliers]).max(axis=0)
    diagonal = float(np.linalg.norm(extent))
    if not np.linalg.det(RT[:3, :3]) > 0:
        raise ToolkitError("the fitted pose has no positive scale", value=RT.round(4).tolist())
    RT[:3, :3] *= diagonal
    return FittedPose(RT, extent / diagonal, inliers, diagonal)
