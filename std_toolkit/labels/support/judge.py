"""Which of several planes carries the objects: a table, not a wall, the floor or a box's side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support.solid import PlacedThing

Array = NDArray[np.float64]
# An object stands on a plane that its lowest point meets to within this, plus what a sensor's bias
# may shift the plane by.
_MEETS_M = 0.015
_SENSOR_BIAS = 0.02
# Cosine between the normal and the image's upward direction: above, a table; below, a wall.
_UPRIGHT, _SIDEWAYS = 0.15, -0.15
# Sine of the angle at which a camera looks down on it: nobody records a table edge-on.
_EDGE_ON = 0.15


@dataclass(frozen=True, eq=False)
class Cameras:
    """Where the cameras stand in the common frame.

    Attributes:
        centres: (M, 3) metres.
        up: (M, 3) the upward direction of each image.
    """

    centres: Array
    up: Array

    @staticmethod
    def of(poses: Sequence[SE3]) -> Cameras:
        """From T_frame_cam of each."""
        return Cameras(np.array([T.t for T in poses]), np.array([-T.R[:, 1] for T in poses]))


@dataclass(frozen=True, eq=False)
class Judgement:
    """A plane `normal . p + offset = 0` as a support.

    Attributes:
        normal, offset: turned towards the cameras.
        score: 0 if it cannot be a support.
        upright: mean cosine between the normal and the images' upward direction.
        height_m: median height of the cameras above it.
        carried: names of the objects that stand on it.
    """

    normal: Array
    offset: float
    score: float
    upright: float
    height_m: float
    carried: tuple[str, ...]


def judge(
    normal: Array,
    offset: float,
    weight: float,
    middle: Array,
    cameras: Cameras,
    things: Sequence[PlacedThing],
) -> Judgement:
    """How well a plane may be what the objects stand on.

    Args:
        weight: share of the points that lie in it.
        middle: (3,) middle of these points.
    """
    heights = cameras.centres @ normal + offset
    if np.median(heights) < 0:
        normal, offset, heights = -normal, -offset, -heights
    height = float(np.median(heights))
    upright = float((cameras.up @ normal).mean())
    # Every camera looks at the table from above.
    score = weight if (heights > 0.02).all() else 0.0
    if upright < _UPRIGHT:
        score *= 0.7 if upright > _SIDEWAYS else 0.3
    sight = np.linalg.norm(cameras.centres - middle, axis=1)
    if float(np.median(heights / np.maximum(sight, 1e-6))) < _EDGE_ON:
        score *= 0.3
    lows = {t.name: float((t.T_frame_obj @ t.solid.hull @ normal + offset).min()) for t in things}
    carried = tuple(n for n, low in lows.items() if abs(low) <= _MEETS_M + _SENSOR_BIAS * height)
    if things:
        score *= 0.1 + len(carried) / len(things)
    return Judgement(normal, offset, score, upright, height, carried)
