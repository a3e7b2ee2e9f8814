"""Brings objects from rough poses to where following the edges finds the right one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.pose_error import rotation_error
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.descent import descend
from std_toolkit.labels.refine.edge_score import EdgeScore, ScoreLevel
from std_toolkit.labels.refine.edge_search import SearchRange, search_edges, spread_views
from std_toolkit.labels.refine.layers import LayerStore
from std_toolkit.labels.refine.measure import PoseState, coarse_to_fine
from std_toolkit.labels.refine.near_symmetry import near_symmetry
from std_toolkit.labels.refine.problem import RefineObject, RefineOptions, RefineView
from std_toolkit.labels.refine.progress import Progress, part, untold

# The search ends within this share of an object's size in the image.
_LEFT = 0.08
_JUDGED = ScoreLevel(pixels=100, tolerance=1.0)
_CANDIDATES = 3
# Wrong poses of faint objects score less, right ones more.
_CONVINCING = 0.55
# Two starts that end within this share of the object's radius have ended in one pose.
_SAME = 0.03
# Turns about the axis of a nearly round object; how many of them are refined at most, if they score
# as high as the best one but for so much; and by how much one has to be better then.
_TURNS = np.deg2rad(np.arange(0, 360, 15))
_TURNS_FOLLOWED, _TURN_SLACK, _TURN_GAIN = 3, 0.15, 0.08


def approach(
    views: Sequence[RefineView],
    objects: Sequence[RefineObject],
    options: RefineOptions,
    *,
    layers: LayerStore | None = None,
    progress: Progress = untold,
) -> list[RefineObject]:
    """The objects, rough ones at poses from which `descend` takes over, found one by one.

    Candidates of the search and the start itself are refined at coarse levels with the other
    objects held; the one whose outlines agree best with the images is taken. An object that is
    nearly round is looked at from all sides then: its round body fits at any turn.

    Args:
        layers: of the objects in these views, where they were cast before.
        progress: told the fraction done.
    """
    around = SearchRange(reach_m=options.rough_m, turn=options.rough_turn)
    found = list(objects)
    layers = LayerStore() if layers is None else layers
    rough = [i for i, o in enumerate(objects) if o.rough and not o.fixed]
    for done, i in enumerate(rough):
        thing = objects[i]
        share = part(progress, done / len(rough), (done + 1) / len(rough))
        share(0)
        others = [replace(o, fixed=True) for k, o in enumerate(found) if k != i]
        few = spread_views(views, thing)
        judge = EdgeScore(few, thing, others, _JUDGED, reach_m=1.3 * around.reach_m)
        if not judge.views:
            continue
        tried = [_settled(few, thing, others, options, judge, layers)]
        for thorough in (False, True):
            # Few objects need the thorough search; the others are done after the quick one.
            searched = part(share, *((0.7, 0.9) if thorough else (0.1, 0.6)))
            candidates = search_edges(
                few,
                thing,
                others,
                around,
                count=_CANDIDATES,
                thorough=thorough,
                progress=searched,
            )
            searched(1)
            for T in candidates:
                start = replace(thing, T_world_obj=T)
                tried.append(_settled(few, start, others, options, judge, layers))
                if _agreed(tried, thing):
                    break
            best = max(tried, key=lambda t: t.score)
            if best.score > _CONVINCING:
                break
        share(0.9)
        at = replace(thing, T_world_obj=best.T_world_obj)
        found[i] = replace(thing, T_world_obj=_look_around(few, at, others, options, judge, layers))
    progress(1)
    return found


def look_around(
    views: Sequence[RefineView],
    thing: RefineObject,
    others: Sequence[RefineObject],
    options: RefineOptions,
    *,
    layers: LayerStore | None = None,
) -> SE3:
    """The pose of an object turned about the axis about which it is nearly round, if that is right.

    Args:
        thing: at a pose that fits but for the turn.
        layers: of the objects in these views, where they were cast before.

    Returns:
        Its pose as it is where there is no such axis, or no turn is clearly better.
    """
    if near_symmetry(thing) is None:
        return thing.T_world_obj
    layers = LayerStore() if layers is None else layers
    few = spread_views(views, thing)
    judge = EdgeScore(few, thing, others, _JUDGED, reach_m=options.rough_m)
    if not judge.views:
        return thing.T_world_obj
    # What sensor depth has placed may be a few pixels off.
    at = replace(thing, T_world_obj=_follow(few, thing, others, options, layers))
    T = _look_around(few, at, others, options, judge, layers)
    return thing.T_world_obj if T is at.T_world_obj else T


def _look_around(
    views: Sequence[RefineView],
    thing: RefineObject,
    others: Sequence[RefineObject],
    options: RefineOptions,
    judge: EdgeScore,
    layers: LayerStore,
) -> SE3:
    axis = near_symmetry(thing)
    if axis is None:
        return thing.T_world_obj
    turns = [axis.turned(thing.T_world_obj, angle) for angle in _TURNS]
    followed = [thing.T_world_obj]
    for k in _peaks(judge.evidence(turns)):
        start = replace(thing, T_world_obj=turns[k])
        followed.append(_follow(views, start, others, options, layers))
    evidence = judge.evidence(followed)
    # A part that is hidden either way says nothing: then it stays.
    clear = evidence.max() > evidence[0] + _TURN_GAIN
    return followed[int(evidence.argmax())] if clear else thing.T_world_obj


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
class _Settled:
    """A pose after following the edges at the coarse levels, and its score."""

    T_world_obj: SE3
    score: float


def _settled(
    views: Sequence[RefineView],
    thing: RefineObject,
    others: Sequence[RefineObject],
    options: RefineOptions,
    judge: EdgeScore,
    layers: LayerStore,
) -> _Settled:
    T = _follow(views, thing, others, options, layers)
    return _Settled(T, float(judge.of([T])[0]))


def _agreed(tried: Sequence[_Settled], thing: RefineObject) -> bool:
    """Whether the last one confirms the best one, which convinces: no more need be tried."""
    *before, last = tried
    best = max(before, key=lambda t: t.score)
    if min(best.score, last.score) < _CONVINCING:
        return False
    shift = np.linalg.norm(best.T_world_obj @ thing.centre - last.T_world_obj @ thing.centre)
    turn = rotation_error(best.T_world_obj, last.T_world_obj, thing.symmetry)
    return bool(shift + turn * thing.radius < _SAME * thing.radius)


def _follow(
    views: Sequence[RefineView],
    thing: RefineObject,
    others: Sequence[RefineObject],
    options: RefineOptions,
    layers: LayerStore,
) -> SE3:
    size = max(_size_px(v, thing) for v in views)
    levels = coarse_to_fine(views, replace(options, search_px=_LEFT * size, refine_scale=False))
    state = PoseState([thing.T_world_obj, *(o.T_world_obj for o in others)])
    try:
        # The two finest levels decide fractions of a pixel: not which pose is right.
        descend(views, [thing, *others], state, levels[:-2], options, layers=layers)
    except ToolkitError:  # out of view in all of them
        return thing.T_world_obj
    return state.poses[0]


def _size_px(view: RefineView, thing: RefineObject) -> float:
    z = float((view.T_world_cam.inverse() @ (thing.T_world_obj @ thing.centre))[2])
    return 2 * thing.radius * view.camera.fx / max(z, thing.radius)
