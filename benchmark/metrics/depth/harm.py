"""Harm: depth that the sensor had right and a restorer made wrong.

A pixel was right if the sensor is within max(3 mm, 1 %) of the truth, and is harmed if the answer
is missing or off by more than twice that. Glass and metal are not looked at: harm is what a method
does to everything else, on opaque objects, on the background, and in a band around glass and
metal, where a swollen object shows first. The band overlaps the other two.
"""

from typing import Any

import cv2
import numpy as np

from benchmark.metrics.depth.figures import CLOSE_M, CLOSE_SHARE, tolerance, usable
from std_toolkit.arrays import Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Column

# An answer is wrong from this many tolerances on: one that moves within the sensor's own noise
# harms nobody.
WRONG = 2.0

# Width of the band around glass and metal, of the width of the image: 16 px of 640.
BAND = 0.025

# Truth that is the sensor itself (TransCG's and ClearPose's background) says nothing of harm. It is
# the sensor's if this share of the pixels agrees to a tenth of the unit of a 16-bit file: a camera
# and an exact model do so in few pixels, rounded to whole millimetres in under a half of them.
_SAME_M, _SAME_SHARE = 1e-4, 0.99


def _column(name: str, heading: str) -> Column:
    return Column(name=name, heading=heading, unit="%", factor=100, digits=2, lower_is_better=True)


COLUMNS = (
    _column("harm_opaque", "harm on opaque objects"),
    _column("harm_background", "harm on the background"),
    _column("harm_band", "harm around glass and metal"),
)
NAMES = tuple(column.name for column in COLUMNS)


def right_pixels(sensor: Any, true: Any) -> Mask:
    """Where the sensor is within max(3 mm, 1 %) of the truth.

    Args:
        sensor: metres, 0 where nothing was measured.
        true: true metres, of that shape; 0 where there is none.

    Returns:
        bool, of that shape.

    >>> right_pixels(np.array([0.5, 0.504, 0.52, 0]), np.array([0.5, 0.5, 0.5, 0.5])).tolist()
    [True, True, False, False]
    """
    there = usable(sensor) & usable(true)
    error = np.abs(np.where(there, sensor, 0).astype(np.float64) - np.where(there, true, 0))
    return there & (error <= tolerance(np.where(there, true, 1)))


def harm(restored: Any, sensor: Any, true: Any, where: Any | None = None) -> float:
    """Share in [0, 1] of the pixels that the sensor had right and the answer has wrong.

    Args:
        restored: answered metres, anything where there is no answer.
        sensor: metres, 0 where nothing was measured.
        true: true metres, 0 where there is none.
        where: bool, which pixels to look at; all by default. All of one shape.

    Returns:
        The share of the right pixels; NaN without any, or where the truth is the sensor itself.

    Raises:
        ToolkitError: shapes that differ.

    >>> sensor, true = np.array([0.5, 0.504, 0.6]), np.full(3, 0.5)
    >>> harm(np.array([0.5, 0.511, 0.5]), sensor, true)
    0.5
    >>> harm(np.array([0.0, 0.504, 0.5]), sensor, true)  # a missing answer harms
    0.5
    """
    shapes = {np.shape(a) for a in (restored, sensor, true, where) if a is not None}
    if len(shapes) > 1:
        raise ToolkitError("answer, sensor, truth and mask must have one shape", value=shapes)
    return _Pixels(restored, sensor, true).share(where)


class _Pixels:
    """What is right, wrong afterwards, and the same as the truth, worked out once for all regions.

    Depth in float32 is exact to well below the tolerances.
    """

    def __init__(self, restored: Any, sensor: Any, true: Any) -> None:
        measured, exact = (np.asarray(a, np.float32) for a in (sensor, true))
        self.both = (measured > 0) & (measured < np.inf) & (exact > 0) & (exact < np.inf)
        with np.errstate(invalid="ignore"):  # what is not finite is in no comparison
            apart = np.abs(measured - exact)
            allowed = np.maximum(exact * np.float32(CLOSE_SHARE), np.float32(CLOSE_M))
            self.right = self.both & (apart <= allowed)
            self.same = self.both & (apart <= _SAME_M)
            off = np.abs(np.asarray(restored, np.float32) - exact)
            # NaN passes no comparison, and a pixel without an answer is wrong.
            self.wrong = self.right & ~((off <= np.float32(WRONG) * allowed) & usable(restored))

    def share(self, where: Any | None) -> float:
        """Harm to the pixels of `where`, or to all."""
        right, wrong, same, both = (
            int(np.count_nonzero(a if where is None else a & where))
            for a in (self.right, self.wrong, self.same, self.both)
        )
        if not right or same >= _SAME_SHARE * both:
            return float("nan")
        return wrong / right


def harm_by_region(
    restored: Any, sensor: Any, true: Any, clear: Mask, objects: Mask
) -> dict[str, float]:
    """Harm on opaque objects, on the background and around glass and metal.

    Args:
        restored, sensor, true: (H, W) metres, as of `harm`.
        clear: (H, W) pixels of glass and metal.
        objects: (H, W) pixels of all objects.

    Returns:
        Shares by the names of `COLUMNS`.

    Raises:
        ToolkitError: shapes that differ.

    >>> table = np.full((4, 80), 0.5)
    >>> clear = np.zeros((4, 80), bool); clear[:, :3] = True
    >>> swollen = table.copy(); swollen[:, :4] = 0.4
    >>> harm_by_region(swollen, table + 0.001, table, clear, clear)["harm_band"]
    0.5
    """
    shapes = {np.shape(a) for a in (restored, sensor, true, clear, objects)}
    if len(shapes) > 1:
        raise ToolkitError("answer, sensor, truth and masks must have one shape", value=shapes)
    near = np.zeros_like(clear)
    if clear.any():
        reach = max(1, round(BAND * clear.shape[1]))
        away = cv2.distanceTransform((~clear).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
        near = (away <= reach) & ~clear
    pixels = _Pixels(restored, sensor, true)
    regions = (objects & ~clear, ~objects, near)
    return {name: pixels.share(where) for name, where in zip(NAMES, regions, strict=True)}
