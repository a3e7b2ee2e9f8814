"""From a rough pose to the basin of the right one: many starts, short fits, the best goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.pose_error import rotation_error
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.labels.refine.depth_steps import icp
from std_toolkit.labels.refine.object_surface import ObjectSurface
from std_toolkit.labels.refine.observed import ObservedRays, ObservedView
from std_toolkit.labels.refine.pose_judge import PoseJudge
from std_toolkit.labels.refine.problem import RefineObject
from std_toolkit.labels.refine.progress import Progress, untold

Array = NDArray[np.float64]

# Pixels looked at in all views together.
_COARSE, _FINE = 900, 3000
_FEWEST_PER_VIEW = 150
_FULL_FITS = 3
_SHORT = (0.05, 0.05, 0.03, 0.03, 0.015, 0.015)
_FULL = (0.03, 0.02, 0.015, *[0.008] * 8)
# A fit may leave the range of the starts by so much; further, it has to be clearly better.
_LEEWAY = 1.3
# Turns about the axes of the bounding box: for the shape, and for the print on it.
_PLAIN_TURNS = np.deg2rad([90, 180, 270])
_PRINT_TURNS = np.deg2rad(np.arange(15, 360, 15))
_PRINT_FITS = 4
# A turned pose may explain the depth so much worse and be looked at; it replaces the other only
# if it is better by the second figure, since nobody starts from the wrong side without a reason.
# In shares of the object's pixels.
_TURN_SLACK, _TURN_MARGIN = 0.15, 0.15


@dataclass(frozen=True)
class Effort:
    """How much is tried.

    Attributes:
        starts: poses that are judged as they are.
        fits: how many of them are fitted shortly.
        seed: of the starts.
    """

    starts: int
    fits: int
    seed: int


QUICK = Effort(200, 6, 0)
# Thin things need it: few of the starts overlap with them, and most of those fit the table.
THOROUGH = Effort(800, 24, 1)


@dataclass(frozen=True, eq=False)
class SearchRange:
    """How far from the start the pose may lie.

    Attributes:
        reach_m: metres.
        turn: radians.
        flips: turns of any angle about the axes of the bounding box are tried too.
    """

    reach_m: float
    turn: float
    flips: bool

    def holds(self, thing: RefineObject, T_world_obj: SE3) -> bool:
        """Whether a pose is about as near to the object's start as asked."""
        start = thing.T_world_obj
        shift = np.linalg.norm(T_world_obj @ thing.centre - start @ thing.centre)
        turn = rotation_error(T_world_obj, start, thing.symmetry)
        return bool(shift < _LEEWAY * self.reach_m and turn < _LEEWAY * self.turn)


def search_pose(
    thing: RefineObject,
    surface: ObjectSurface,
    observed: Sequence[ObservedView],
    search: SearchRange,
    *,
    effort: Effort = QUICK,
    known: Sequence[SE3] = (),
    progress: Progress = untold,
) -> SE3:
    """The best T_world_obj by sensor depth (and print, where the mesh has one).

    Args:
        known: fitted poses that take part in the end.
        progress: told the fraction done.
    """
    coarse = [o.thinned(_share(_COARSE, observed)) for o in observed]
    fine = [o.thinned(_share(_FINE, observed)) for o in observed]
    coarse_rays, fine_rays = ObservedRays.of(coarse), ObservedRays.of(fine)
    first = PoseJudge(thing, surface, coarse, tolerance_m=0.03, reach_m=search.reach_m)
    starts = _starts(thing, search, effort)
    progress(0.1)
    ranked = np.argsort([first.depth(T) for T in starts], kind="stable")[: effort.fits]
    # The start itself always has its chance.
    chosen = list(dict.fromkeys([0, *(int(k) for k in ranked)]))
    short = [icp(surface, thing, coarse_rays, starts[k], gates_m=_SHORT) for k in chosen]
    progress(0.4)
    middle = PoseJudge(thing, surface, fine, tolerance_m=0.015, reach_m=search.reach_m)
    short.sort(key=lambda T: middle(T).total)
    full = [icp(surface, thing, fine_rays, T, gates_m=_FULL) for T in short[:_FULL_FITS]]
    full += known
    progress(0.7)
    judge = PoseJudge(thing, surface, fine, tolerance_m=0.008, reach_m=search.reach_m)
    near = [T for T in full if search.holds(thing, T)]
    best = min(near or full, key=lambda T: judge(T).total)
    if not search.flips:
        return best
    full += [
        icp(surface, thing, fine_rays, T, gates_m=_FULL)
        for T in _rivals(thing, surface, best, coarse_rays, middle)[:_FULL_FITS]
    ]
    rival = min(full, key=lambda T: judge(T).total)
    return rival if judge(rival).total < judge(best).total - _TURN_MARGIN else best


def _rivals(
    thing: RefineObject,
    surface: ObjectSurface,
    best: SE3,
    seen: ObservedRays,
    judge: PoseJudge,
) -> list[SE3]:
    """Turns of a pose that the shape may tell apart, and that fit but for the print; best first."""
    turned = _turned(best, thing.centre, _PLAIN_TURNS)
    rivals = [icp(surface, thing, seen, T, gates_m=_SHORT) for T in turned]
    if thing.colors is not None:
        limit = judge.depth(best) + _TURN_SLACK
        printed = _turned(best, thing.centre, _PRINT_TURNS)
        fitting = [T for T in printed if judge.depth(T) < limit]
        fitting.sort(key=judge.print, reverse=True)
        rivals += fitting[:_PRINT_FITS]
    return sorted(rivals, key=lambda T: judge(T).total)


def _share(total: int, observed: Sequence[ObservedView]) -> int:
    return max(_FEWEST_PER_VIEW, total // len(observed))


def _starts(thing: RefineObject, search: SearchRange, effort: Effort) -> list[SE3]:
    """The start and poses around it, the same ones every time."""
    rng = np.random.default_rng(effort.seed)
    T = thing.T_world_obj
    poses = [T]
    for _ in range(effort.starts):
        shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        R = so3_exp(axis * rng.uniform(0, search.turn)) @ T.R
        # About the object's centre, wherever the mesh has its origin.
        centre = T @ thing.centre + shift * rng.uniform(0, search.reach_m)
        poses.append(SE3(R, centre - R @ thing.centre))
    return poses


def _turned(T: SE3, centre: Array, angles: Array) -> list[SE3]:
    """The pose turned by each of the angles about each axis of the bounding box."""
    turns = [so3_exp(axis * angle) for axis in np.eye(3) for angle in angles]
    return [T @ SE3(R, centre - R @ centre) for R in turns]
