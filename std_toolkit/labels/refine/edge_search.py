"""From a rough pose to the basin of the right one, on the images' edges alone.

Following the edges around a contour finds the right pose from where most contour points are
nearest to their own edges. From 30 mm and 15 degrees off they are not, least of all on glass and
metal, so poses all around the start are tried: a population evolves (R. Storn, K. Price,
"Differential Evolution", J. of Global Optimization 11, 1997, strategy current-to-best) under the
score of `edge_score`, at a growing resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.edge_score import EdgeScore, ScoreLevel
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.labels.refine.progress import Progress, untold

Array = NDArray[np.float64]

# Resolutions and the generations at each.
_QUICK = (
    (ScoreLevel(pixels=28, tolerance=2.0), 2),
    (ScoreLevel(pixels=44, tolerance=2.0), 4),
    (ScoreLevel(pixels=44, tolerance=1.0), 4),
)
# The faint outline of a glass on a printed cloth does not show in fewer pixels.
_THOROUGH = (
    (ScoreLevel(pixels=48, tolerance=2.0), 4),
    (ScoreLevel(pixels=64, tolerance=2.0), 5),
    (ScoreLevel(pixels=64, tolerance=1.0), 5),
)
_STARTS, _POPULATION = 256, 48
_DIFFERENCE, _TO_BEST, _NOISE = 0.7, 0.8, 0.03
# Parents towards which the others are drawn.
_BEST = 8
# Poses beyond the range pay for it: per square of the excess, in units of the range.
_BEYOND = 2.0
# Candidates that differ by less, in radii of the object, end in the same pose.
_DISTINCT = 0.12
# More views make the search slower, not better.
_MOST_VIEWS = 5


@dataclass(frozen=True, kw_only=True)
class SearchRange:
    """How far the start may be off.

    Attributes:
        reach_m: of the object's centre, metres.
        turn: radians.
    """

    reach_m: float = 0.035
    turn: float = float(np.deg2rad(18))


def search_edges(
    views: Sequence[RefineView],
    thing: RefineObject,
    others: Sequence[RefineObject],
    around: SearchRange | None = None,
    *,
    count: int = 3,
    thorough: bool = False,
    progress: Progress = untold,
) -> list[SE3]:
    """The most promising poses T_world_obj around an object's start, best first.

    Args:
        views: images; up to five of them, from the most different sides, are looked at.
        thing: the object at its start.
        others: neighbours at their poses; they hide what is behind them.
        count: most poses returned; they differ from each other.
        thorough: at a higher resolution, for several times the time.
        progress: told the fraction done.

    Returns:
        At least one pose; the start itself where the object is out of view.
    """
    around = around or SearchRange()
    moves = _Moves(thing, around, np.random.default_rng(0))
    chosen = spread_views(views, thing)
    x = moves.scattered(_STARTS)
    cost = np.zeros(len(x))
    plan = _THOROUGH if thorough else _QUICK
    # Judging the starts takes as long as a few generations.
    steps, done = 3 + sum(generations for _, generations in plan), 3
    for number, (level, generations) in enumerate(plan):
        score = EdgeScore(chosen, thing, others, level, reach_m=around.reach_m)
        if not score.views:
            return [thing.T_world_obj]
        value = moves.penalised(score, x)
        if number == 0:
            best = np.argsort(-value, kind="stable")[:_POPULATION]
            x, value = x[best], value[best]
        for _ in range(generations):
            progress(done / steps)
            done += 1
            trial = moves.children(x, value)
            tried = moves.penalised(score, trial)
            better = tried > value
            x = np.where(better[:, None], trial, x)
            value = np.where(better, tried, value)
        cost = -value
    return moves.distinct(x[np.argsort(cost, kind="stable")], count)


def spread_views(views: Sequence[RefineView], thing: RefineObject) -> list[RefineView]:
    """At most five views, seen from the object as far apart as possible; the first among them."""
    if len(views) <= _MOST_VIEWS:
        return list(views)
    rays = np.array([v.T_world_cam.t for v in views]) - thing.T_world_obj @ thing.centre
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9)
    nearest = rays @ rays[0]
    chosen = [0]
    while len(chosen) < _MOST_VIEWS:
        chosen.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, rays @ rays[chosen[-1]])
    return [views[i] for i in sorted(chosen)]


class _Moves:
    """Moves (N, 6) of an object from its start: shift of its centre (world), turn (object)."""

    def __init__(self, thing: RefineObject, around: SearchRange, rng: np.random.Generator) -> None:
        self._thing, self._range, self._rng = thing, around, rng
        self._size = np.array([around.reach_m] * 3 + [around.turn] * 3)
        self._centre = thing.T_world_obj @ thing.centre
        axes = [np.asarray(axis) for axis, _ in thing.symmetry.continuous]
        # Turns about an axis of symmetry change nothing.
        self._turns = np.eye(3) - sum((np.outer(a, a) for a in axes[:1]), np.zeros((3, 3)))

    def scattered(self, count: int) -> Array:
        """Evenly in the range; the first is none."""
        x = np.hstack([self._ball(count), self._ball(count)]) * self._size
        x[0] = 0
        return self._seen(x)

    def children(self, x: Array, value: Array) -> Array:
        """One for each: drawn towards one of the best, by a difference of two, and shaken."""
        rng, n = self._rng, len(x)
        best = x[np.argsort(-value, kind="stable")[rng.integers(0, _BEST, n)]]
        first, second = x[rng.integers(0, n, n)], x[rng.integers(0, n, n)]
        factor = _DIFFERENCE * rng.uniform(0.5, 1, (n, 1))
        drawn = 2 * _TO_BEST * factor * rng.uniform(0, 1, (n, 1)) * (best - x)
        noise = _NOISE * self._size * rng.normal(size=x.shape)
        return self._seen(x + drawn + factor * (first - second) + noise)

    def penalised(self, score: EdgeScore, x: Array) -> Array:
        """Scores of the moves, less what lies beyond the range."""
        value = score(*self._poses(x))
        for part, limit in ((x[:, :3], self._range.reach_m), (x[:, 3:], self._range.turn)):
            excess = np.maximum(np.linalg.norm(part, axis=1) / limit - 1, 0)
            value = value - _BEYOND * excess**2
        return value

    def distinct(self, x: Array, count: int) -> list[SE3]:
        """Poses of the first moves that differ from all before."""
        scale = np.array([1.0] * 3 + [self._thing.radius] * 3)
        kept: list[Array] = []
        for row in x:
            apart = [np.linalg.norm((row - k) * scale) for k in kept]
            if all(d > _DISTINCT * self._thing.radius for d in apart):
                kept.append(row)
            if len(kept) == count:
                break
        R, t = self._poses(np.array(kept))
        return [SE3(a, b) for a, b in zip(R, t, strict=True)]

    def _poses(self, x: Array) -> tuple[Array, Array]:
        R = self._thing.T_world_obj.R @ _rotations(x[:, 3:])
        return R, self._centre + x[:, :3] - R @ self._thing.centre

    def _seen(self, x: Array) -> Array:
        x[:, 3:] = x[:, 3:] @ self._turns
        return x

    def _ball(self, count: int) -> Array:
        v = self._rng.normal(size=(count, 3))
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        return np.asarray(v * self._rng.uniform(size=(count, 1)) ** (1 / 3))


def _rotations(w: Array) -> Array:
    """Rotation matrices (N, 3, 3) of rotation vectors (N, 3): Rodrigues' formula."""
    angle = np.maximum(np.linalg.norm(w, axis=1), 1e-12)
    x, y, z = (w / angle[:, None]).T
    zero = np.zeros(len(w))
    K = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * K + (1 - cosine) * (K @ K))
