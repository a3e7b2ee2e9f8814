"""How well the outlines of an object at a pose agree with the edges of several images.

No edge is searched for and nothing is minimised here: the score ranks poses, of which there may
be hundreds, and decides between refined ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.caster import WorldCaster
from std_toolkit.labels.refine.edge_map import EdgeMap
from std_toolkit.labels.refine.outlines import OutlineCaster, Window
from std_toolkit.labels.refine.problem import RefineObject, RefineView

Array = NDArray[np.float64]

# A pose that hides half of the outline does not win by showing only what agrees.
_FULL_OUTLINE = 0.6
_SMALLEST_WINDOW_PX = 12


@dataclass(frozen=True, kw_only=True)
class ScoreLevel:
    """A resolution.

    Attributes:
        pixels: size at which the object is looked at, across the sphere around it.
        tolerance: pixels by which an outline may miss its edge.
    """

    pixels: float
    tolerance: float


class EdgeScore:
    """The score of poses of one object.

    Args:
        views: images.
        thing: the object near the poses that are asked for.
        others: neighbours at their poses; they hide what is behind them.
        reach_m: how far the object may be from the pose of `thing`.
    """

    def __init__(
        self,
        views: Sequence[RefineView],
        thing: RefineObject,
        others: Sequence[RefineObject],
        level: ScoreLevel,
        *,
        reach_m: float,
    ) -> None:
        self._caster = OutlineCaster(thing)
        world = WorldCaster(others, [o.T_world_obj for o in others]) if others else None
        self._views = []
        for view in views:
            found = _window(view, thing, world, level, reach_m)
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
        """(N,) of poses T_world_obj that differ in what of the outline they show, among them.

        Here a part that is shown where the images have its edges counts for the pose, and one that
        is hidden does not: the score alone is a mean, and higher where doubtful parts are hidden.
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
    thing: RefineObject,
    world: WorldCaster | None,
    level: ScoreLevel,
    reach_m: float,
) -> tuple[Window, EdgeMap] | None:
    """The window of a view around the object, and its edges; None if it is out of view."""
    centre = view.T_world_cam.inverse() @ (thing.T_world_obj @ thing.centre)
    if centre[2] < thing.radius + 0.02:
        return None
    size = 2 * thing.radius * view.camera.fx / centre[2]
    camera, image = view.at_scale(min(1.0, level.pixels / size))
    middle = camera.project(centre)
    half = 1.15 * (thing.radius + reach_m) * camera.fx / centre[2] + 6
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
