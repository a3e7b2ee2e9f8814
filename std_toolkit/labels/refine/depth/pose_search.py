"""Search for the right pose from a rough one: many starts, short fits, the best is kept.

Poses are ranked by sensor depth, agreement of the mesh's texture with the images, and distance
from the start. For the depth cost, the scene is rendered with the object at the pose. Every
measured pixel of the window counts for every pose: the rendered depth of the object, of the other
objects or of the background plane is compared with the sensor depth. A pose is penalised for
surface in front of the measurement (free space) and for measured surface that nothing explains. It
cannot win by hiding or by ignoring pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, rotation_error, so3_exp
from std_toolkit.labels.refine.depth.depth_steps import icp
from std_toolkit.labels.refine.depth.observed import ObservedPixels, ObservedRays, ObservedView
from std_toolkit.labels.refine.object_surface import ObjectSurface, color_agreement
from std_toolkit.labels.refine.problem import Progress, RefineObject, no_progress
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Number of pixels used in all views together.
_COARSE, _FINE = 900, 3000

_FEWEST_PER_VIEW = 150

_FULL_FITS = 3

_SHORT = (0.05, 0.05, 0.03, 0.03, 0.015, 0.015)

_FULL = (0.03, 0.02, 0.015, *[0.008] * 8)


# Rotations about the axes of the bounding box: for the shape, and for the texture on it.
_PLAIN_TURNS = np.deg2rad([90, 180, 270])

_TEXTURE_TURNS = np.deg2rad(np.arange(15, 360, 15))

_TEXTURE_FITS = 4


# Weight of full texture agreement, in fractions of the object's pixels.
_TEXTURE = 1.0


# Cost of a rotation from the start, per 1 - cos(angle): half a turn costs 6 % of the pixels.
_TURN = 0.03

# Cost of a shift beyond the reach, per reach: other objects may look like this one.
_BEYOND = 2.0

# A reading in front of the expected surface may come from an object without a label. It counts
# less than a reading behind it, which no other object explains.
_UNLABELLED = 0.7

# Cost of a pixel that the object does not cover where the background is unknown.
_UNKNOWN = 0.3


@dataclass(frozen=True, kw_only=True)
class PoseSearchSettings(Settings):
    """Which pose of a search on sensor depth wins."""

    leeway: float = limit(1.3, source=NOT_RECORDED)
    """factor by which a fit may leave the range of the starts; beyond, it must be clearly better"""
    turn_slack: float = limit(0.15, source=NOT_RECORDED)
    """a rotated pose that explains the depth worse by more, in fractions of the object's
    pixels, is not considered"""
    turn_margin: float = limit(0.15, source="a start from the wrong side is unlikely")
    """a rotated pose must be better by this to replace the other"""
    chance: float = limit(
        0.3,
        source="light, gloss and products with another texture agree by as much by chance",
    )
    """a smaller correlation of the texture is ignored"""


@dataclass(frozen=True)
class Effort:
    """Effort of the search.

    Attributes:
        starts: number of poses to score.
        fits: number of them to fit shortly.
        seed: seed of the starts.
    """

    starts: int
    fits: int
    seed: int


QUICK = Effort(200, 6, 0)

# For thin objects: few of the starts overlap with them, and most of those fit the table.
THOROUGH = Effort(800, 24, 1)


@dataclass(frozen=True, eq=False)
class SearchRange:
    """Search range around the start.

    Attributes:
        reach_m: metres.
        turn: radians.
        flips: also try rotations by any angle about the axes of the bounding box.
    """

    reach_m: float
    turn: float
    flips: bool

    def holds(self, obj: RefineObject, T_world_obj: SE3) -> bool:
        """Whether a pose is about within the range around the object's start."""
        limits = PoseSearchSettings.current()
        start = obj.T_world_obj
        shift = np.linalg.norm(T_world_obj @ obj.centre - start @ obj.centre)
        turn = rotation_error(T_world_obj, start, obj.symmetry)
        return bool(shift < limits.leeway * self.reach_m and turn < limits.leeway * self.turn)


def search_pose(
    obj: RefineObject,
    surface: ObjectSurface,
    observed: Sequence[ObservedView],
    search: SearchRange,
    *,
    effort: Effort = QUICK,
    known: Sequence[SE3] = (),
    progress: Progress = no_progress,
) -> SE3:
    """The best T_world_obj by sensor depth (and texture, if the mesh has one).

    Args:
        known: fitted poses to compare with at the end.
        progress: called with the completed fraction.
    """
    limits = PoseSearchSettings.current()
    coarse = [o.thinned(_share(_COARSE, observed)) for o in observed]
    fine = [o.thinned(_share(_FINE, observed)) for o in observed]
    coarse_rays, fine_rays = ObservedRays.of(coarse), ObservedRays.of(fine)
    first = PoseScorer(obj, surface, coarse, tolerance_m=0.03, reach_m=search.reach_m)
    starts = _starts(obj, search, effort)
    progress(0.1)
    ranked = np.argsort([first.depth(T) for T in starts], kind="stable")[: effort.fits]
    # The start itself is always tried.
    chosen = list(dict.fromkeys([0, *(int(k) for k in ranked)]))
    short = [icp(surface, obj, coarse_rays, starts[k], gates_m=_SHORT) for k in chosen]
    progress(0.4)
    middle = PoseScorer(obj, surface, fine, tolerance_m=0.015, reach_m=search.reach_m)
    short.sort(key=lambda T: middle(T).total)
    full = [icp(surface, obj, fine_rays, T, gates_m=_FULL) for T in short[:_FULL_FITS]]
    full += known
    progress(0.7)
    scorer = PoseScorer(obj, surface, fine, tolerance_m=0.008, reach_m=search.reach_m)
    near = [T for T in full if search.holds(obj, T)]
    best = min(near or full, key=lambda T: scorer(T).total)
    if not search.flips:
        return best
    full += [
        icp(surface, obj, fine_rays, T, gates_m=_FULL)
        for T in _rivals(obj, surface, best, coarse_rays, middle)[:_FULL_FITS]
    ]
    rival = min(full, key=lambda T: scorer(T).total)
    return rival if scorer(rival).total < scorer(best).total - limits.turn_margin else best


def _rivals(
    obj: RefineObject,
    surface: ObjectSurface,
    best: SE3,
    sensor_rays: ObservedRays,
    scorer: PoseScorer,
) -> list[SE3]:
    """Rotations of a pose that fit the depth and may differ in texture; best first."""
    turned = _turned(best, obj.centre, _PLAIN_TURNS)
    rivals = [icp(surface, obj, sensor_rays, T, gates_m=_SHORT) for T in turned]
    if obj.colors is not None:
        limit = scorer.depth(best) + PoseSearchSettings.current().turn_slack
        textured = _turned(best, obj.centre, _TEXTURE_TURNS)
        fitting = [T for T in textured if scorer.depth(T) < limit]
        fitting.sort(key=scorer.texture, reverse=True)
        rivals += fitting[:_TEXTURE_FITS]
    return sorted(rivals, key=lambda T: scorer(T).total)


def _share(total: int, observed: Sequence[ObservedView]) -> int:
    return max(_FEWEST_PER_VIEW, total // len(observed))


def _starts(obj: RefineObject, search: SearchRange, effort: Effort) -> list[SE3]:
    """The start and poses around it; deterministic."""
    rng = np.random.default_rng(effort.seed)
    T = obj.T_world_obj
    poses = [T]
    for _ in range(effort.starts):
        shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        R = so3_exp(axis * rng.uniform(0, search.turn)) @ T.R
        # About the object's centre, not the mesh origin.
        centre = T @ obj.centre + shift * rng.uniform(0, search.reach_m)
        poses.append(SE3(R, centre - R @ obj.centre))
    return poses


def _turned(T: SE3, centre: Array, angles: Array) -> list[SE3]:
    """The pose rotated by each of the angles about each axis of the bounding box."""
    turns = [so3_exp(axis * angle) for axis in np.eye(3) for angle in angles]
    return [T @ SE3(R, centre - R @ centre) for R in turns]


@dataclass(frozen=True)
class PoseScore:
    """Score of a pose; lower is better.

    Attributes:
        depth: cost of the depth per pixel of the object, about -0.7 (all explained) to 1.
        texture: correlation of the mesh's colours with the image, 0 if they are not informative.
        total: cost with texture and the prior of the start.
    """

    depth: float
    texture: float
    total: float


class PoseScorer:
    """Compares poses of an object on fixed pixels.

    Args:
        tolerance_m: tolerance of the depth; see `DepthCost`.
        reach_m: largest distance of the object from its start.
    """

    def __init__(
        self,
        obj: RefineObject,
        surface: ObjectSurface,
        views: Sequence[ObservedPixels],
        *,
        tolerance_m: float,
        reach_m: float,
    ) -> None:
        self._obj, self._surface, self._views = obj, surface, views
        self._reach = reach_m
        self._cost = DepthCost(surface, views, tolerance_m)
        self._area = max(self._shown(obj.T_world_obj), 30)

    def depth(self, T_world_obj: SE3) -> float:
        """Cost of the depth per pixel of the object at its start."""
        return self._cost(T_world_obj) / self._area

    def texture(self, T_world_obj: SE3) -> float:
        """Agreement of the mesh's colours with the images; see `color_agreement`."""
        if self._obj.colors is None:
            return 0.0
        rendered, seen, masks = [], [], []
        for view in self._views:
            hits = self._surface.cast(view.directions, view.T_world_cam.inverse() @ T_world_obj)
            shown = np.isfinite(hits.depth) & (hits.depth < view.others)
            image = np.zeros_like(view.color)
            image[shown] = self._obj.colors.at(hits.face[shown], hits.corners[shown])
            rendered.append(image.reshape(-1, view.columns, 3))
            seen.append(view.color.reshape(-1, view.columns, 3))
            masks.append(shown.reshape(-1, view.columns))
        return color_agreement(rendered, seen, masks)

    def __call__(self, T_world_obj: SE3) -> PoseScore:
        """All evidence on a pose."""
        depth, agreement = self.depth(T_world_obj), self.texture(T_world_obj)
        start = self._obj.T_world_obj
        turn = rotation_error(T_world_obj, start, self._obj.symmetry)
        centre = self._obj.centre
        shift = float(np.linalg.norm(T_world_obj @ centre - start @ centre))
        strayed = _TURN * (1 - float(np.cos(turn))) + _BEYOND * max(shift / self._reach - 1, 0.0)
        worth = _TEXTURE * max(agreement - PoseSearchSettings.current().chance, 0.0)
        return PoseScore(depth, agreement, depth - worth + strayed)

    def _shown(self, T_world_obj: SE3) -> int:
        """Pixels that the object covers."""
        return sum(
            int(
                np.isfinite(
                    self._surface.cast(v.directions, v.T_world_cam.inverse() @ T_world_obj).depth
                ).sum()
            )
            for v in self._views
        )


def pixel_cost(
    expected: NDArray[np.floating], sensor: NDArray[np.floating], tolerance_m: float
) -> Array:
    """(N,) 0 to 1: disagreement of expected and measured depth, saturating at `tolerance_m`."""
    gap = (expected - sensor) / tolerance_m
    return np.where(gap < 0, np.minimum(-gap, 1.0), np.minimum(gap, _UNLABELLED))


class DepthCost:
    """The cost of poses on fixed pixels.

    Args:
        surface: of the object.
        views: pixels that count.
        tolerance_m: larger differences are clipped to it.
    """

    def __init__(
        self, surface: ObjectSurface, views: Sequence[ObservedPixels], tolerance_m: float
    ) -> None:
        self._surface = surface
        self._tolerance = tolerance_m
        rays = ObservedRays.of(views)
        rays = rays.only(rays.sensor > 0)
        behind = np.minimum(rays.others, rays.background)
        # Depth behind the expected background is other background.
        empty = pixel_cost(np.maximum(behind, rays.sensor), rays.sensor, tolerance_m)
        empty[np.isinf(behind)] = _UNKNOWN
        self._rays, self._empty = rays, empty

    def __call__(self, T_world_obj: SE3) -> float:
        """Sum of the costs of the pixels, less that of the scene without the object.

        In pixels; negative if the object explains the measurements.
        """
        rays = self._rays
        depth = self._surface.cast_from(rays.origins, rays.directions, T_world_obj).depth
        shown = np.isfinite(depth) & (depth < rays.others)
        cost = pixel_cost(depth[shown], rays.sensor[shown], self._tolerance)
        return float((cost - self._empty[shown]).sum())
