"""Brings objects from rough poses into the basin of convergence of the edge refinement.

Handles shapes that are rotationally symmetric except for a part, such as a mug with its handle.
From a start with a wrong rotation about that axis, edge refinement fits the round body to a pixel,
but no nearby edge corrects the other part. The module then tries rotations about the axis.
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
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# The search ends within this fraction of an object's size in the image.
_LEFT = 0.08

_JUDGED = edge_search.ScoreLevel(pixels=100, tolerance=1.0)

_CANDIDATES = 3


# Two starts that end within this fraction of the object's radius have the same result.
_SAME = 0.03

# Rotations about the axis of a nearly round object; the largest number to refine, of those whose
# score is within a margin of the best; and the margin by which one must be better.
_TURNS = np.deg2rad(np.arange(0, 360, 15))

_TURNS_FOLLOWED = 3

Array = NDArray[np.float64]

# Faces with normals along the axis are ignored.
_SIDEWAYS = 0.5

# A face belongs to the round body if its normal passes the axis within this fraction of the radius.
_CLOSE = 0.03


_ROUNDS = 8


@dataclass(frozen=True, kw_only=True)
class ApproachSettings(Settings):
    """Which pose of a search on edges wins."""

    convincing: float = limit(
        0.55,
        source="wrong poses of faint objects score less, right ones more",
    )
    """score at which the search ends"""
    turn_slack: float = limit(0.15, source=NOT_RECORDED)
    """turns about the axis of a nearly round object that score worse than the best by more are
    left out"""
    turn_gain: float = limit(0.08, source=NOT_RECORDED)
    """a turn must be better by this to replace the pose"""
    round: float = limit(0.6, source="less is another shape")
    """smallest round fraction of the lateral surface of a nearly round object"""
    wholly_round: float = limit(0.985, source=NOT_RECORDED)
    """an object with a larger round fraction has no turn to find"""


def approach(
    views: Sequence[problem.RefineView],
    objects: Sequence[problem.RefineObject],
    options: problem.RefineOptions,
    *,
    layers: LayerStore | None = None,
    progress: problem.Progress = problem.no_progress,
) -> list[problem.RefineObject]:
    """The objects, rough ones at poses from which `descend` converges, found one by one.

    The candidates of the search and the start are refined at coarse levels with the other objects
    fixed. The one whose outlines agree best with the images is used. For a nearly round object all
    rotations about its axis are then compared, because its round body fits at any of them.

    Args:
        layers: cached layers of the objects in these views, if any.
        progress: called with the completed fraction.
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
            if best.score > ApproachSettings.current().convincing:
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
    """Correct the rotation of a nearly round object about its axis.

    Args:
        obj: the object at a pose that is right except for this rotation.
        layers: cached layers of the objects in these views, if any.

    Returns:
        The pose, unchanged if there is no such axis or no rotation is clearly better.
    """
    if near_symmetry(obj) is None:
        return obj.T_world_obj
    layers = LayerStore() if layers is None else layers
    few = edge_search.spread_views(views, obj)
    scorer = edge_search.EdgeScore(few, obj, others, _JUDGED, reach_m=options.rough_m)
    if not scorer.views:
        return obj.T_world_obj
    # Objects aligned with sensor depth may be a few pixels off.
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
    # A part that is hidden in both poses is no evidence: the pose is kept.
    clear = evidence.max() > evidence[0] + ApproachSettings.current().turn_gain
    return followed[int(evidence.argmax())] if clear else obj.T_world_obj


def _peaks(scores: NDArray[np.float64]) -> list[int]:
    """Rotations to refine: local maxima that are nearly the highest, without the first.

    Args:
        scores: (N,) evidence around a circle; the first is that of the current pose.
    """
    peak = (scores >= np.roll(scores, 1)) & (scores > np.roll(scores, -1))
    peak &= scores > scores.max() - ApproachSettings.current().turn_slack
    chosen = [int(k) for k in np.flatnonzero(peak) if k > 0]
    return sorted(chosen, key=lambda k: -scores[k])[:_TURNS_FOLLOWED]


@dataclass(frozen=True, eq=False)
class _Converged:
    """A pose after edge refinement at the coarse levels, and its score."""

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
    """Whether the last pose confirms the best with a high score, so that the search can stop."""
    *before, last = tried
    best = max(before, key=lambda t: t.score)
    if min(best.score, last.score) < ApproachSettings.current().convincing:
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
        # The two finest levels matter for sub-pixel accuracy only, not for the choice of pose.
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
        """A pose after a rotation of the object about the line, radians."""
        R = so3_exp(self.direction * angle)
        return T @ SE3(R, self.point - R @ self.point)


def near_symmetry(obj: problem.RefineObject) -> Axis | None:
    """The axis about which most of the surface is round, but not all; along x, y, or z.

    None also for an object that is declared symmetric: its shape does not determine the rotation.
    """
    limits = ApproachSettings.current()
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
        if limits.round < share < limits.wholly_round:
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
