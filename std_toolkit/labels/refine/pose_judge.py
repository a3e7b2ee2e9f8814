"""Which of several poses is the right one: depth, print, and nearness to where it started."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from std_toolkit.geometry.pose_error import rotation_error
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.appearance import color_agreement
from std_toolkit.labels.refine.object_surface import ObjectSurface
from std_toolkit.labels.refine.observed import ObservedPixels
from std_toolkit.labels.refine.pose_cost import DepthCost
from std_toolkit.labels.refine.problem import RefineObject

# What a full agreement of the print is worth, in shares of the object's pixels.
_PRINT = 1.0
# Below this it is worth nothing: light, gloss and products that changed their print agree by as
# much by chance.
_CHANCE = 0.3
# What a turn away from the start costs, per 1 - cos(angle): half a turn 6 % of the pixels.
_TURN = 0.03
# What a shift beyond the reach costs, per reach: there are other things that look like this one.
_BEYOND = 2.0


@dataclass(frozen=True)
class Verdict:
    """One pose judged; less is better.

    Attributes:
        depth: cost of the depth per pixel of the object, about -0.7 (all explained) to 1.
        print: correlation of the mesh's colours with the image, 0 where they cannot tell.
        total: with the print and the prior of the start.
    """

    depth: float
    print: float
    total: float


class PoseJudge:
    """Compares poses of an object on fixed pixels.

    Args:
        tolerance_m: of the depth; see `DepthCost`.
        reach_m: how far from its start the object may be.
    """

    def __init__(
        self,
        thing: RefineObject,
        surface: ObjectSurface,
        views: Sequence[ObservedPixels],
        *,
        tolerance_m: float,
        reach_m: float,
    ) -> None:
        self._thing, self._surface, self._views = thing, surface, views
        self._reach = reach_m
        self._cost = DepthCost(surface, views, tolerance_m)
        self._area = max(self._shown(thing.T_world_obj), 30)

    def depth(self, T_world_obj: SE3) -> float:
        """Cost of the depth per pixel of the object at its start."""
        return self._cost(T_world_obj) / self._area

    def print(self, T_world_obj: SE3) -> float:
        """Agreement of the mesh's colours with the images; see `color_agreement`."""
        if self._thing.colors is None:
            return 0.0
        rendered, seen, masks = [], [], []
        for view in self._views:
            hits = self._surface.cast(view.directions, view.T_world_cam.inverse() @ T_world_obj)
            shown = np.isfinite(hits.depth) & (hits.depth < view.others)
            image = np.zeros_like(view.color)
            image[shown] = self._thing.colors.at(hits.face[shown], hits.corners[shown])
            rendered.append(image.reshape(-1, view.columns, 3))
            seen.append(view.color.reshape(-1, view.columns, 3))
            masks.append(shown.reshape(-1, view.columns))
        return color_agreement(rendered, seen, masks)

    def __call__(self, T_world_obj: SE3) -> Verdict:
        """All evidence on a pose."""
        depth, agreement = self.depth(T_world_obj), self.print(T_world_obj)
        start = self._thing.T_world_obj
        turn = rotation_error(T_world_obj, start, self._thing.symmetry)
        centre = self._thing.centre
        shift = float(np.linalg.norm(T_world_obj @ centre - start @ centre))
        strayed = _TURN * (1 - float(np.cos(turn))) + _BEYOND * max(shift / self._reach - 1, 0.0)
        worth = _PRINT * max(agreement - _CHANCE, 0.0)
        return Verdict(depth, agreement, depth - worth + strayed)

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
