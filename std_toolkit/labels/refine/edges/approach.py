"""Brings objects from rough poses to where following the edges finds the right one.

The axis about which a mesh is round but for a part of it, such as a mug but for its handle.

From a start that is turned too far about it, following edges fits the round body to a pixel, and
the rest stays where it is: nothing near it tells where it belongs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_error, so3_exp
from std_toolkit.labels.refine import problem
from std_toolkit.labels.refine.caster import LayerStore
from std_toolkit.labels.refine.edges import edge_search
from std_toolkit.labels.refine.edges.descent import descend
from std_toolkit.labels.refine.edges.measure import PoseState, coarse_to_fine

# The search ends within this share of an object's size in the image.
_LEFT = 0.08

_JUDGED = edge_search.ScoreLevel(pixels=100, tolerance=1.0)

_CANDIDATES = 3

# Wrong poses of faint objects score less, right ones more.
_CONVINCING = 0.55

# Two starts that end within this share of the object's radius have ended in one pose.
_SAME = 0.03

# Turns about the axis of a nearly round object; how many of them are refined at most, if they score
# as high as the best one but for so much; and by how much one has to be better then.
_TURNS = np.deg2rad(np.arange(0, 360, 15))

_TURNS_FOLLOWED, _TURN_SLACK, _TURN_GAIN = 3, 0.15, 0.08

Array = NDArray[np.float64]

# Faces that look along the axis say nothing.
_SIDEWAYS = 0.5

# A face belongs to the round body if its normal passes the axis within this share of the radius.
_CLOSE = 0.03

# Shares of the sideways surface that is round: less is another shape, more shows no turn.
_ROUND, _WHOLLY_ROUND = 0.6, 0.985

_ROUNDS = 8


def approach(
    views: Sequence[problem.RefineView],
    objects: Sequence[problem.RefineObject],
    options: problem.RefineOptions,
    *,
    layers: LayerStore | None = None,
    progress: problem.Progress = problem.no_progress,
) -> list[problem.RefineObject]:
    """The objects, rough ones at poses from which `descend` takes over, found one by one.

    Candidates of the search and the start itself are refined at coarse levels with the other
    objects held; the one whose outlines agree best with the images is taken. An object that is
    nearly round is looked at from all sides then: its round body fits at any turn.

    Args:
        layers: of the objects in these views, where they were cast before.
        progress: told the fraction done.
    """
    around = edge_search.SearchRange(reach_m=options.rough_m, turn=options.rough_turn)
    found = list(objects)
    layers = LayerStore() if layers is None else layers
    rough = [i for i, o in enumerate(objects) if o.rough and not o.fixed]
    for done, i in enumerate(rough):
        obj = objects[i]
        share = problem.sub_progress(progress, done / len(rough), (done + 1) / len(rough))
        share(0)
        others = [replace(o, fixed=True) for k, o in enumerate(found) if k != i]
        few = edge_search.spread_views(views, obj)
        scorer = edge_search.EdgeScore(few, obj, others, _JUDGED, reach_m=1.3 * around.reach_m)
        if not scorer.views:
            continue
        tried = [_converged(few, obj, others, options, scorer, layers)]
        for thorough in (False, True):
            # Few objects need the thorough search; the others are done after the quick one.
            searched = problem.sub_progress(share, *((0.7, 0.9) if thorough else (0.1, 0.6)))
            candidates = edge_search.search_edges(
                few,
                obj,
                others,
                around,
                count=_CANDIDATES,
                thorough=thorough,
                progress=searched,
            )
            searched(1)
            for T in candidates:
                start = replace(obj, T_world_obj=T)
                tried.append(_converged(few, start, others, options, scorer, layers))
                if _agreed(tried, obj):
                    break
            best = max(tried, key=lambda t: t.score)
            if best.score > _CONVINCING:
                break
        share(0.9)
        at = replace(obj, T_world_obj=best.T_world_obj)
        found[i] = replace(obj, T_world_obj=_search_turns(few, at, others, options, scorer, layers))
    progress(1)
    return found


def search_turns(
    views: Sequence[problem.RefineView],
    obj: problem.RefineObject,
    others: Sequence[problem.RefineObject],
    options: problem.RefineOptions,
    *,
    layers: LayerStore | None = None,
) -> SE3:
    """The pose of an object turned about the axis about which it is nearly round, if that is right.

    Args:
        obj: at a pose that fits but for the turn.
        layers: of the objects in these views, where they were cast before.

    Returns:
        Its pose as it is where there is no such axis, or no turn is clearly better.
    """
    if near_symmetry(obj) is None:
        return obj.T_world_obj
    layers = LayerStore() if layers is None else layers
    few = edge_search.spread_views(views, obj)
    scorer = edge_search.EdgeScore(few, obj, others, _JUDGED, reach_m=options.rough_m)
    if not scorer.views:
        return obj.T_world_obj
    # What sensor depth has placed may be a few pixels off.
    at = replace(obj, T_world_obj=_follow(few, obj, others, options, layers))
    T = _search_turns(few, at, others, options, scorer, layers)
    return obj.T_world_obj if T is at.T_world_obj else T


def _search_turns(
    views: Sequence[problem.RefineView],
    obj: problem.RefineObject,
    others: Sequence[problem.RefineObject],
    options: problem.RefineOptions,
    scorer: edge_search.EdgeScore,
    layers: LayerStore,
) -> SE3:
    axis = near_symmetry(obj)
    if axis is None:
        return obj.T_world_obj
    turns = [axis.turned(obj.T_world_obj, angle) for angle in _TURNS]
    followed = [obj.T_world_obj]
    for k in _peaks(scorer.evidence(turns)):
        start = replace(obj, T_world_obj=turns[k])
        followed.append(_follow(views, start, others, options, layers))
    evidence = scorer.evidence(followed)
    # A part that is hidden either way says nothing: then it stays.
    clear = evidence.max() > evidence[0] + _TURN_GAIN
    return followed[int(evidence.argmax())] if clear else obj.T_world_obj


def _peaks(scores: NDArray[np.float64]) -> list[int]:
    """Which turns to follow: higher than on both sides and nearly the highest, but not the first.

    Args:
        scores: (N,) evidence around a circle; the first is that of the pose as it is.
    """
    peak = (scores >= np.roll(scores, 1)) & (scores > np.roll(scores, -1))
    peak &= scores > scores.max() - _TURN_SLACK
    chosen = [int(k) for k in np.flatnonzero(peak) if k > 0]
    return sorted(chosen, key=lambda k: -scores[k])[:_TURNS_FOLLOWED]


@dataclass(frozen=True, eq=False)
class _Converged:
    """A pose after following the edges at the coarse levels, and its score."""

    T_world_obj: SE3
    score: float


def _converged(
    views: Sequence[problem.RefineView],
    obj: problem.RefineObject,
    others: Sequence[problem.RefineObject],
    options: problem.RefineOptions,
    scorer: edge_search.EdgeScore,
    layers: LayerStore,
) -> _Converged:
    T = _follow(views, obj, others, options, layers)
    return _Converged(T, float(scorer.of([T])[0]))


def _agreed(tried: Sequence[_Converged], obj: problem.RefineObject) -> bool:
    """Whether the last one confirms the best one, which convinces: no more need be tried."""
    *before, last = tried
    best = max(before, key=lambda t: t.score)
    if min(best.score, last.score) < _CONVINCING:
        return False
    shift = np.linalg.norm(best.T_world_obj @ obj.centre - last.T_world_obj @ obj.centre)
    turn = rotation_error(best.T_world_obj, last.T_world_obj, obj.symmetry)
    return bool(shift + turn * obj.radius < _SAME * obj.radius)


def _follow(
    views: Sequence[problem.RefineView],
    obj: problem.RefineObject,
    others: Sequence[problem.RefineObject],
    options: problem.RefineOptions,
    layers: LayerStore,
) -> SE3:
    size = max(_size_px(v, obj) for v in views)
    levels = coarse_to_fine(views, replace(options, search_px=_LEFT * size, refine_scale=False))
    state = PoseState([obj.T_world_obj, *(o.T_world_obj for o in others)])
    try:
        # The two finest levels decide fractions of a pixel: not which pose is right.
        descend(views, [obj, *others], state, levels[:-2], options, layers=layers)
    except ToolkitError:  # out of view in all of them
        return obj.T_world_obj
    return state.poses[0]


def _size_px(view: problem.RefineView, obj: problem.RefineObject) -> float:
    z = float((view.T_world_cam.inverse() @ (obj.T_world_obj @ obj.centre))[2])
    return 2 * obj.radius * view.camera.fx / max(z, obj.radius)


@dataclass(frozen=True, eq=False)
class Axis:
    """A line in the mesh frame: a unit vector, and a point (3,) in metres."""

    direction: Array
    point: Array

    def turned(self, T: SE3, angle: float) -> SE3:
        """A pose after a turn of the object about the line, radians."""
        R = so3_exp(self.direction * angle)
        return T @ SE3(R, self.point - R @ self.point)


def near_symmetry(obj: problem.RefineObject) -> Axis | None:
    """The axis about which most of the surface is round, but not all; along x, y, or z.

    None also where the object is declared symmetric: what shows a turn then is not its shape.
    """
    if obj.symmetry.continuous:
        return None
    corners = obj.vertices[obj.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    some = area > 0
    normals, middles, area = cross[some] / area[some, None], corners[some].mean(axis=1), area[some]
    found: list[tuple[float, Axis]] = []
    for k in range(3):
        i, j = (m for m in range(3) if m != k)
        n, x = normals[:, [i, j]], middles[:, [i, j]]
        length = np.linalg.norm(n, axis=1)
        sideways = length > _SIDEWAYS
        if not sideways.any():
            continue
        n, x, weight = n[sideways] / length[sideways, None], x[sideways], area[sideways]
        across = np.column_stack([-n[:, 1], n[:, 0]])
        point = _common_point(across, x, weight, _CLOSE * obj.radius)
        miss = np.abs((across * (x - point)).sum(axis=1))
        share = float(weight[miss < _CLOSE * obj.radius].sum() / weight.sum())
        if _ROUND < share < _WHOLLY_ROUND:
            place = obj.centre.copy()
            place[[i, j]] = point
            found.append((share, Axis(np.eye(3)[k], place)))
    return max(found, key=lambda f: f[0])[1] if found else None


def _common_point(across: Array, x: Array, weight: Array, close: float) -> Array:
    """(2,) the point that most of the lines through x (N, 2), normal to across (N, 2), pass."""
    offset = (across * x).sum(axis=1)
    robust = np.ones(len(x))
    spread = 8 * close
    point = np.zeros(2)
    for _ in range(_ROUNDS):
        w = weight * robust
        A = (across * w[:, None]).T @ across + 1e-12 * w.sum() * np.eye(2)
        point = np.linalg.solve(A, (across * w[:, None]).T @ offset)
        robust = 1 / (1 + ((across @ point - offset) / spread) ** 2) ** 2
        spread = max(spread / 2, close)
    return np.asarray(point)
