"""A depth sensor that reads too far puts the table too low: by how much, and how to tell.

Every reading of a camera at height h above the table is too deep by the same factor, which moves
the table down by the same share of h. Two things tell the factor: points of the reconstruction on
the table, which know nothing of the sensor; and, more weakly, cameras at different heights, whose
tables must be one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.labels.support.evidence import Points
from std_toolkit.labels.support.plane import Plane

Array = NDArray[np.float64]
# Sensors are off by 2 %; beyond this what was found is something else.
_LARGEST_BIAS = 0.04
_FEWEST_POINTS = 80
_FEWEST_FRAMES = 6
# Of the bias. Camera poses are off too, and in sensors the bias changes with the distance: what
# different heights tell counts only where they agree to a fraction of a millimetre.
_LARGEST_ERROR_BY_POINTS = 0.002
_LARGEST_ERROR_BY_HEIGHTS = 0.0007
# Errors of neighbouring points of a reconstruction are not independent.
_CORRELATED = 5.0


@dataclass(frozen=True)
class Correction:
    """Where the table is, relative to where the sensor sees it.

    Attributes:
        shift_m: along the plane's normal, from the sensor's plane to the table.
        depth_factor: sensor depth over true depth.
        uncertainty_m: of the shift, two standard errors.
        note: for people.
    """

    shift_m: float
    depth_factor: float
    uncertainty_m: float
    note: str


def correction_by_points(
    plane: Plane, points: Array, height_m: float, centre: Array, radius_m: float
) -> Correction | None:
    """From reconstructed points (N, 3) near a plane that was found in depth.

    Args:
        height_m: of the cameras above the plane.
        centre, radius_m: the part of the plane that the sensor saw.

    Returns:
        None where too few of the points lie together near the plane.
    """
    reach = np.linalg.norm(plane.project(points) - centre, axis=1)
    distance = plane.signed_distance(points[reach < 1.3 * radius_m])
    distance = np.sort(distance[np.abs(distance) < _LARGEST_BIAS * height_m])
    if len(distance) < _FEWEST_POINTS:
        return None
    # Most of what lies so near the table is the table: the shortest interval with half of the
    # points is where they crowd.
    half = len(distance) // 2
    start = int((distance[half:] - distance[:-half]).argmin())
    shift = float(np.median(distance[start : start + half]))
    spread = 1.4826 * float(np.median(np.abs(distance - shift)))
    crowd = distance[np.abs(distance - shift) < 3 * spread]
    shift = float(np.mean(crowd))
    error = float(np.std(crowd)) / np.sqrt(len(crowd) / _CORRELATED)
    if spread > 0.015 * height_m or error > _LARGEST_ERROR_BY_POINTS * height_m:
        return None
    factor = height_m / (height_m - shift)
    return Correction(
        shift,
        factor,
        max(2 * error, 0.0005),
        _told(shift, factor, "the points of the reconstruction"),
    )


def correction_by_heights(
    plane: Plane, points: Points, inliers: NDArray[np.bool_], centres: Array
) -> Correction | None:
    """From cameras at different heights, whose tables do not agree.

    Args:
        plane: fitted to the points of all views together.
        centres: (M, 3) of the cameras.

    Returns:
        None where the heights are too alike or the scatter is too large to tell.
    """
    heights, errors = [], []
    for view in np.unique(points.view[inliers]):
        mine = inliers & (points.view == view)
        if mine.sum() >= _FEWEST_POINTS:
            heights.append(float(plane.signed_distance(centres[view])))
            errors.append(float(np.median(plane.signed_distance(points.xyz[mine]))))
    h, e = np.array(heights), np.array(errors)
    if len(h) < _FEWEST_FRAMES or np.ptp(h) < 0.1 * h.mean():
        return None
    # A camera at height h above the sensors' common plane sees it off by
    # e = (1 + b) shift - b h, where b is the relative bias and `shift` leads to the table.
    A = np.stack([np.ones_like(h), -h], axis=1)
    (constant, bias), *_ = np.linalg.lstsq(A, e, rcond=None)
    scatter = float(np.sum((e - A @ [constant, bias]) ** 2)) / (len(h) - 2)
    covariance = scatter * np.linalg.inv(A.T @ A)
    error = float(np.sqrt(covariance[1, 1]))
    if error > _LARGEST_ERROR_BY_HEIGHTS or not 2 * error < abs(bias) < _LARGEST_BIAS:
        return None
    shift = float(constant / (1 + bias))
    factor = float(1 + bias)
    return Correction(
        shift,
        factor,
        2 * float(np.sqrt(covariance[0, 0])) + 0.0005,
        _told(shift, factor, "what cameras at different heights see"),
    )


def _told(shift_m: float, factor: float, evidence: str) -> str:
    """Note on a correction; what is below the digits that are told is none."""
    millimetres, percent = f"{1000 * shift_m:+.1f}", f"{100 * abs(factor - 1):.1f}"
    if float(millimetres) == 0:
        return f"confirmed by {evidence}"
    sensor = f"the sensor reads {percent} % too {'far' if factor > 1 else 'near'}"
    if float(percent) == 0:
        sensor = "the sensor reads right to 0.1 %"
    return f"moved by {millimetres} mm onto {evidence}: {sensor}"
