"""The transform between the worlds of two scenes, from points whose place is known in both."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Similarity, ransac_similarity, umeyama
from std_toolkit.geometry.se3 import skew
from std_toolkit.settings import Settings, limit

Array = NDArray[np.float64]
Found = Literal["board", "features", "points"]

WORDS: dict[Found, str] = {
    "board": "the board",
    "features": "matched features",
    "points": "given points",
}
_PLURALS: dict[Found, str] = {"board": "corners", "features": "features", "points": "points"}
_SAMPLES = 4000
# With at most this many points, every triple is tried.
_FEW = 12


@dataclass(frozen=True, kw_only=True)
class RelationSettings(Settings):
    """When points determine how the worlds of two scenes lie to each other."""

    feature_mm: float = limit(
        6.0, unit="mm", source="points triangulated from cameras that err by 1 mm and 0.1 deg"
    )
    """a matched feature farther away than this after the fit is an outlier"""
    point_mm: float = limit(
        20.0, unit="mm", source="clicks of 2 px on a table seen at 30 deg from 0.6 m: 6 mm along it"
    )
    """the same for a point that a person gives"""
    corner_mm: float = limit(
        5.0, unit="mm", source="a corner of a tag, to 1 px, in cameras that err by 1 mm"
    )
    """the same for a corner of the board"""
    fewest_features: int = limit(
        30, source="of 400 matches between two other tables, no four agree"
    )
    """features that must agree"""
    least_share: float = limit(
        0.15, source="11 % on a pattern that repeats, 43 to 70 % on one table from two paths"
    )
    """part of the matched features that must agree"""
    rival_share: float = limit(
        0.5, source="a repeated pattern, or one half of the objects moved as one"
    )
    """another transform must not explain this many of the remaining matches, in parts of those that
    agree on the best one"""
    largest_scale: float = limit(0.03, source="two depth sensors that are off by 1.5 %")
    """largest difference of the scales of the two worlds"""
    noted_scale: float = limit(0.005, source="the systematic error of a scanned mesh")
    """a larger difference of the scales is noted"""
    largest_deviation_mm: float = limit(
        15.0, unit="mm", source="refinement converges from 30 mm: two standard deviations"
    )
    """largest standard deviation of the place of an object that follows from the points"""
    noise_mm: float = limit(
        1.0, unit="mm", source="the noise of depth at a pixel; three points fit by chance"
    )
    """points are not better known than this, whatever the residual of few points"""
    flat: float = limit(0.2, source="a set that is mirrored fits this flat or not at all")
    """points are taken as flat if they extend across their plane by less than this, in parts of
    their second largest extent"""


@dataclass(frozen=True, eq=False)
class SharedPoints:
    """Points of two scenes that are the same.

    Attributes:
        by: where they are from.
        a, b: (N, 3) in the worlds of scenes A and B, metres.
        eye_a, eye_b: (3,) mean position of the cameras that saw them.
        notes: sentences on how they were found.
    """

    by: Found
    a: Array
    b: Array
    eye_a: Array
    eye_b: Array
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class WorldRelation:
    """How the worlds of two scenes lie to each other.

    Attributes:
        by: what it was found by.
        T_b_a: the world of scene A to that of scene B, metres.
        count: number of points that agree.
        total: number of points.
        residual_mm: root mean square of their distances after the fit.
        inliers: (N,) which points agree.
        centre: (3,) mean of the points that agree, world of B.
        information: (3, 3) sum of squares of the points about `centre`, for `deviation_mm`.
        notes: sentences on what to know.
    """

    by: Found
    T_b_a: SE3
    count: int
    total: int
    residual_mm: float
    inliers: NDArray[np.bool_]
    centre: Array
    information: Array
    notes: tuple[str, ...] = ()

    def sentence(self) -> str:
        """What it rests on, such as "by the board: 96 corners, residual 0.4 mm"."""
        count = f"{self.count}" if self.count == self.total else f"{self.count} of {self.total}"
        return (
            f"by {WORDS[self.by]}: {count} {_PLURALS[self.by]}, residual {self.residual_mm:.1f} mm"
        )

    def deviation_mm(self, point: Array) -> float:
        """Standard deviation of a place in the world of B, along its weakest direction."""
        noise = max(
            self.residual_mm * np.sqrt(self.count / max(self.count - 2, 1)),
            RelationSettings.current().noise_mm,
        )
        lever = skew(np.asarray(point) - self.centre)
        turn = np.linalg.pinv(self.information)
        spread = np.eye(3) / self.count + lever @ turn @ lever.T
        return float(noise * np.sqrt(np.linalg.eigvalsh(spread)[-1]))


def relate_worlds(points: SharedPoints) -> WorldRelation:
    """The rigid transform that most of the points agree on.

    Raises:
        ToolkitError: too few points agree, two transforms explain them, they lie on a line, they
            only fit seen from behind, or the scales of the worlds differ.
    """
    limits = RelationSettings.current()
    name, features = WORDS[points.by], points.by == "features"
    fewest = limits.fewest_features if features else 3
    if len(points.a) < fewest:
        raise _unrelated(f"{len(points.a)} {_PLURALS[points.by]}, {fewest} are needed")
    threshold = (limits.feature_mm if features else limits.point_mm) / 1000
    try:
        found, inliers = _robust_fit(points.a, points.b, threshold)
    except ToolkitError as error:
        raise _unrelated(f"no three {_PLURALS[points.by]} agree: {error.problem}") from error
    T_b_a = SE3(found.R, found.t)
    count = int(inliers.sum())
    share = limits.least_share if features else 0.5
    if count < fewest or count <= share * len(inliers):
        raise _unrelated(f"{count} of {len(inliers)} {_PLURALS[points.by]} agree")
    if features:
        _refuse_rival(points, T_b_a, inliers, threshold)
    notes = list(points.notes)
    if not features and count < len(inliers):
        left = ", ".join(str(i + 1) for i in np.flatnonzero(~inliers))
        notes.append(f"point {left} does not fit the others and was left out")
    relation = make_relation(points, T_b_a, inliers, tuple(notes))
    _refuse_other_side(points, relation)
    scale = 1.0
    if count >= limits.fewest_features:
        scale = umeyama(points.a[inliers], points.b[inliers]).scale
    return with_scale(relation, scale, name)


def _robust_fit(a: Array, b: Array, threshold: float) -> tuple[Similarity, NDArray[np.bool_]]:
    """The rigid fit that most points agree on: of few points all triples are tried."""
    if len(a) > _FEW:
        return ransac_similarity(
            a, b, threshold_m=threshold, with_scale=False, max_iterations=_SAMPLES
        )
    best = np.zeros(len(a), dtype=bool)
    least = np.inf
    problem = ToolkitError("they are on lines")
    for rows in combinations(range(len(a)), 3):
        try:
            fit = umeyama(a[list(rows)], b[list(rows)], with_scale=False)
        except ToolkitError as error:
            problem = error
            continue
        distance = np.linalg.norm(fit @ a - b, axis=1)
        agree = distance < threshold
        cost = float(np.minimum(distance, threshold).sum())
        if agree[list(rows)].all() and cost < least:
            best, least = agree, cost
    if not best.any():
        distances = [np.linalg.norm(p[:, None] - p, axis=-1) for p in (a, b)]
        off = 1000 * float(np.abs(distances[0] - distances[1]).max())
        if off > 1000 * threshold:
            problem = ToolkitError(f"their distances differ by up to {off:.0f} mm")
        raise problem
    return umeyama(a[best], b[best], with_scale=False), best


def make_relation(
    points: SharedPoints, T_b_a: SE3, inliers: NDArray[np.bool_], notes: tuple[str, ...]
) -> WorldRelation:
    """The relation with residual and deviation from the points that agree."""
    a, b = T_b_a @ points.a[inliers], points.b[inliers]
    centre = b.mean(axis=0)
    r = b - centre
    return WorldRelation(
        by=points.by,
        T_b_a=T_b_a,
        count=int(inliers.sum()),
        total=len(inliers),
        residual_mm=1000 * float(np.sqrt(((a - b) ** 2).sum(axis=1).mean())),
        inliers=inliers,
        centre=centre,
        information=(r**2).sum() * np.eye(3) - r.T @ r,
        notes=notes,
    )


def with_scale(relation: WorldRelation, scale: float, name: str) -> WorldRelation:
    """The relation, with a note if the scales differ.

    Args:
        scale: size of things in the world of B by their size in that of A.
        name: what it was measured by.

    Raises:
        ToolkitError: they differ too much to be of the same things.
    """
    limits = RelationSettings.current()
    differs = abs(scale - 1)
    if differs > limits.largest_scale:
        raise ToolkitError(
            f"the scales of the two scenes differ by {100 * differs:.1f} % (by {name})",
            hint="the camera poses of one have a wrong scale; see `std-curate poses`",
        )
    if differs <= limits.noted_scale:
        return relation
    note = f"the scales of the two scenes differ by {100 * differs:.1f} %: refine the poses"
    return WorldRelation(**{**vars(relation), "notes": (*relation.notes, note)})


def _refuse_rival(
    points: SharedPoints, T_b_a: SE3, inliers: NDArray[np.bool_], threshold: float
) -> None:
    """Raise an error if another transform explains nearly as many matches."""
    others = ~inliers
    count, most = int(inliers.sum()), RelationSettings.current().rival_share
    if others.sum() <= most * count:
        return
    try:
        rival, agreeing = ransac_similarity(
            points.a[others], points.b[others], threshold_m=threshold, with_scale=False
        )
    except ToolkitError:
        return
    apart = float(np.median(np.linalg.norm(rival @ points.a - T_b_a @ points.a, axis=1)))
    if agreeing.sum() > most * count and apart > threshold:
        raise _unrelated(
            f"{count} features agree on one transform, {int(agreeing.sum())} on another, "
            f"{1000 * apart:.0f} mm away",
            "a pattern repeats, or objects were moved together; give three points (--points)",
        )


def _refuse_other_side(points: SharedPoints, relation: WorldRelation) -> None:
    """Raise an error if flat points only fit when one scene sees them from behind.

    Two of three points that were interchanged fit after the surface is turned over.
    """
    a, b = points.a[relation.inliers], points.b[relation.inliers]
    _, extents, axes = np.linalg.svd(a - a.mean(axis=0), full_matrices=False)
    if len(extents) == 3 and extents[2] > RelationSettings.current().flat * extents[1]:
        return
    normal = axes[2] if len(axes) == 3 else np.cross(axes[0], axes[1])
    before = normal @ (points.eye_a - a.mean(axis=0))
    after = (relation.T_b_a.R @ normal) @ (points.eye_b - b.mean(axis=0))
    if before * after < 0:
        raise _unrelated(
            "the points fit only with the surface turned over",
            "two points are interchanged, or on a line; check their order",
        )


def _unrelated(problem: str, hint: str = "") -> ToolkitError:
    return ToolkitError(
        f"the two scenes cannot be related: {problem}",
        hint=hint or "do they show the same table? Other ways: --by board, --points FILE",
    )
