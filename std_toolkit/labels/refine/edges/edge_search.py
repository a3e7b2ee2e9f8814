"""Search for the right pose from a rough one with image edges only.

Edge refinement converges if most contour points are nearest to their own edges. From 30 mm and 15
degrees off they are not, least of all on glass and metal. The search therefore tries poses around
the start by differential evolution (R. Storn, K. Price, "Differential Evolution", J. of Global
Optimization 11, 1997, strategy current-to-best) with the score `edge_score`, at an increasing
resolution.

The score measures how well the outlines of an object at a pose agree with the edges of several
images. It neither searches edges nor optimises: it ranks hundreds of poses and selects between
refined ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.caster import WorldCaster
from std_toolkit.labels.refine.edges.outlines import EdgeMap, OutlineCaster, Window
from std_toolkit.labels.refine.problem import Progress, RefineObject, RefineView, no_progress

# A pose that hides half of the outline must not win by the visible part that agrees.
_FULL_OUTLINE = 0.6

_SMALLEST_WINDOW_PX = 12

Array = NDArray[np.float64]

_STARTS, _POPULATION = 256, 48

_DIFFERENCE, _TO_BEST, _NOISE = 0.7, 0.8, 0.03

# Number of best parents towards which the others move.
_BEST = 8

# Penalty of poses beyond the range: per square of the excess, in units of the range.
_BEYOND = 2.0

# Candidates that differ by less, in radii of the object, converge to the same pose.
_DISTINCT = 0.12

# More views make the search slower, not better.
_MOST_VIEWS = 5


@dataclass(frozen=True, kw_only=True)
class ScoreLevel:
    """A resolution.

    Attributes:
        pixels: size of the object's bounding sphere in the image.
        tolerance: pixels by which an outline may miss its edge.
    """

    pixels: float
    tolerance: float


class EdgeScore:
    """The score of poses of one object.

    Args:
        views: images.
        obj: the object near the poses to score.
        others: neighbours at their poses, which act as occluders.
        reach_m: largest distance of the object from the pose of `obj`.
    """

    def __init__(
        self,
        views: Sequence[RefineView],
        obj: RefineObject,
        others: Sequence[RefineObject],
        level: ScoreLevel,
        *,
        reach_m: float,
    ) -> None:
        self._caster = OutlineCaster(obj)
        world = WorldCaster(others, [o.T_world_obj for o in others]) if others else None
        self._views = []
        for view in views:
            found = _window(view, obj, world, level, reach_m)
            if found is not None:
                self._views.append(found)

    @property
    def views(self) -> int:
        """Number of views that may show the object."""
        return len(self._views)

    def __call__(self, R: Array, t: Array) -> Array:
        """(N,) of the poses T_world_obj = (R (N, 3, 3), t (N, 3)); 0 is chance, 2.9 perfect."""
        total, outline, usual = self._sums(R, t)
        return total / np.maximum(outline, _FULL_OUTLINE * usual)

    def evidence(self, poses: Sequence[SE3]) -> Array:
        """(N,) scores of poses T_world_obj that show different parts of the outline.

        A visible part with edges in the images counts for the pose, a hidden part does not. The
        plain score is a mean, which is higher if doubtful parts are hidden.
        """
        total, _, usual = self._sums(np.stack([T.R for T in poses]), np.stack([T.t for T in poses]))
        return total / usual

    def _sums(self, R: Array, t: Array) -> tuple[Array, Array, float]:
        """Sums (N,) of agreement and of the outline's length, and the usual length."""
        total, outline = np.zeros(len(R)), np.zeros(len(R))
        for window, edges in self._views:
            found = self._caster.outlines(window, R, t)
            agreement = edges.at(found.angle, found.v, found.u)
            total += np.bincount(found.pose, found.weight * agreement, len(R))
            outline += np.bincount(found.pose, found.weight, len(R))
        some = outline[outline > 0]
        return total, outline, float(np.median(some)) if len(some) else 1.0

    def of(self, poses: Sequence[SE3]) -> Array:
        """(N,) of single poses T_world_obj."""
        return self(np.stack([T.R for T in poses]), np.stack([T.t for T in poses]))


def _window(
    view: RefineView,
    obj: RefineObject,
    world: WorldCaster | None,
    level: ScoreLevel,
    reach_m: float,
) -> tuple[Window, EdgeMap] | None:
    """The window of a view around the object, and its edges; None if it is out of view."""
    centre = view.T_world_cam.inverse() @ (obj.T_world_obj @ obj.centre)
    if centre[2] < obj.radius + 0.02:
        return None
    size = 2 * obj.radius * view.camera.fx / centre[2]
    camera, image = view.at_scale(min(1.0, level.pixels / size))
    middle = camera.project(centre)
    half = 1.15 * (obj.radius + reach_m) * camera.fx / centre[2] + 6
    low = np.maximum(np.floor(middle - half), 0).astype(int)
    high = np.minimum(np.ceil(middle + half), camera.size).astype(int)
    if (high - low < _SMALLEST_WINDOW_PX).any():
        return None
    (x0, y0), (x1, y1) = low, high
    others = np.full((y1 - y0, x1 - x0), np.inf, np.float32)
    if world is not None:
        box = int(x0), int(y0), int(x1) - 1, int(y1) - 1
        others = world.window(camera, view.T_world_cam, box)[0].depth
    edges = EdgeMap.of(image[y0:y1, x0:x1], tolerance=level.tolerance)
    return Window(camera, view.T_world_cam, int(x0), int(y0), others), edges


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


@dataclass(frozen=True, kw_only=True)
class SearchRange:
    """Largest error of the start.

    Attributes:
        reach_m: distance of the object's centre, metres.
        turn: radians.
    """

    reach_m: float = 0.035
    turn: float = float(np.deg2rad(18))


def search_edges(
    views: Sequence[RefineView],
    obj: RefineObject,
    others: Sequence[RefineObject],
    around: SearchRange | None = None,
    *,
    count: int = 3,
    thorough: bool = False,
    progress: Progress = no_progress,
) -> list[SE3]:
    """The most promising poses T_world_obj around an object's start, best first.

    Args:
        views: images; up to five of them, from the most different sides, are used.
        obj: the object at its start.
        others: neighbours at their poses, which act as occluders.
        count: largest number of poses to return; they differ from each other.
        thorough: use a higher resolution, which takes several times as long.
        progress: called with the completed fraction.

    Returns:
        At least one pose; the start itself if the object is out of view.
    """
    around = around or SearchRange()
    moves = _Moves(obj, around, np.random.default_rng(0))
    chosen = spread_views(views, obj)
    x = moves.scattered(_STARTS)
    cost = np.zeros(len(x))
    plan = _THOROUGH if thorough else _QUICK
    # Scoring the starts takes as long as a few generations.
    steps, done = 3 + sum(generations for _, generations in plan), 3
    for number, (level, generations) in enumerate(plan):
        score = EdgeScore(chosen, obj, others, level, reach_m=around.reach_m)
        if not score.views:
            return [obj.T_world_obj]
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


def spread_views(views: Sequence[RefineView], obj: RefineObject) -> list[RefineView]:
    """At most five views, as far apart as possible seen from the object, including the first."""
    if len(views) <= _MOST_VIEWS:
        return list(views)
    rays = np.array([v.T_world_cam.t for v in views]) - obj.T_world_obj @ obj.centre
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9)
    nearest = rays @ rays[0]
    chosen = [0]
    while len(chosen) < _MOST_VIEWS:
        chosen.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, rays @ rays[chosen[-1]])
    return [views[i] for i in sorted(chosen)]


class _Moves:
    """Motions (N, 6) of an object from its start: translation (world), rotation (object)."""

    def __init__(self, obj: RefineObject, around: SearchRange, rng: np.random.Generator) -> None:
        self._obj, self._range, self._rng = obj, around, rng
        self._size = np.array([around.reach_m] * 3 + [around.turn] * 3)
        self._centre = obj.T_world_obj @ obj.centre
        axes = [np.asarray(axis) for axis, _ in obj.symmetry.continuous]
        # Rotations about an axis of symmetry have no effect.
        self._turns = np.eye(3) - sum((np.outer(a, a) for a in axes[:1]), np.zeros((3, 3)))

    def scattered(self, count: int) -> Array:
        """Uniform samples of the range; the first is zero."""
        x = np.hstack([self._ball(count), self._ball(count)]) * self._size
        x[0] = 0
        return self._seen(x)

    def children(self, x: Array, value: Array) -> Array:
        """One mutant per member: towards one of the best, plus a difference of two, plus noise."""
        rng, n = self._rng, len(x)
        best = x[np.argsort(-value, kind="stable")[rng.integers(0, _BEST, n)]]
        first, second = x[rng.integers(0, n, n)], x[rng.integers(0, n, n)]
        factor = _DIFFERENCE * rng.uniform(0.5, 1, (n, 1))
        drawn = 2 * _TO_BEST * factor * rng.uniform(0, 1, (n, 1)) * (best - x)
        noise = _NOISE * self._size * rng.normal(size=x.shape)
        return self._seen(x + drawn + factor * (first - second) + noise)

    def penalised(self, score: EdgeScore, x: Array) -> Array:
        """Scores of the motions, minus the penalty beyond the range."""
        value = score(*self._poses(x))
        for part, limit in ((x[:, :3], self._range.reach_m), (x[:, 3:], self._range.turn)):
            excess = np.maximum(np.linalg.norm(part, axis=1) / limit - 1, 0)
            value = value - _BEYOND * excess**2
        return value

    def distinct(self, x: Array, count: int) -> list[SE3]:
        """Poses of the first motions that differ from all before."""
        scale = np.array([1.0] * 3 + [self._obj.radius] * 3)
        kept: list[Array] = []
        for row in x:
            apart = [np.linalg.norm((row - k) * scale) for k in kept]
            if all(d > _DISTINCT * self._obj.radius for d in apart):
                kept.append(row)
            if len(kept) == count:
                break
        R, t = self._poses(np.array(kept))
        return [SE3(a, b) for a, b in zip(R, t, strict=True)]

    def _poses(self, x: Array) -> tuple[Array, Array]:
        R = self._obj.T_world_obj.R @ _rotations(x[:, 3:])
        return R, self._centre + x[:, :3] - R @ self._obj.centre

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
