"""How well a pose explains the sensor depth: the scene is rendered with it and compared.

Every measured pixel of the window counts for every pose. Where the object is rendered, its depth
is compared with the sensor's; where it is not, that of the other objects or of the background
plane. So a pose pays for surface in front of what was measured (there is free space) and for
measured surface that nothing explains, and a pose does not win by hiding or by leaving pixels out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.object_surface import ObjectSurface
from std_toolkit.labels.refine.observed import ObservedPixels, ObservedRays

Array = NDArray[np.float64]

# Something in front of what is expected may be a thing that has no label: it counts less than
# surface in free space, which nothing excuses.
_UNLABELLED = 0.7
# Without a known background, a pixel that the object does not cover.
_UNKNOWN = 0.3


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
        tolerance_m: differences beyond it count as this one.
    """

    def __init__(
        self, surface: ObjectSurface, views: Sequence[ObservedPixels], tolerance_m: float
    ) -> None:
        self._surface = surface
        self._tolerance = tolerance_m
        rays = ObservedRays.of(views)
        rays = rays.only(rays.sensor > 0)
        behind = np.minimum(rays.others, rays.background)
        # What lies behind the expected background is other background.
        empty = pixel_cost(np.maximum(behind, rays.sensor), rays.sensor, tolerance_m)
        empty[np.isinf(behind)] = _UNKNOWN
        self._rays, self._empty = rays, empty

    def __call__(self, T_world_obj: SE3) -> float:
        """Sum of the costs of the pixels, less that of the scene without the object.

        Negative where the object explains what was measured. In pixels.
        """
        rays = self._rays
        depth = self._surface.cast_from(rays.origins, rays.directions, T_world_obj).depth
        shown = np.isfinite(depth) & (depth < rays.others)
        cost = pixel_cost(depth[shown], rays.sensor[shown], self._tolerance)
        return float((cost - self._empty[shown]).sum())
