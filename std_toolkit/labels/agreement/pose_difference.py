"""Difference of two poses of one object, split into typical annotation errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Symmetry, mssd, rotation_error, so3_log
from std_toolkit.geometry.symmetry import fixed_point, nearest_variant
from std_toolkit.settings import NOT_RECORDED, Settings, limit

if TYPE_CHECKING:
    from std_toolkit.geometry import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DifferenceSettings(Settings):
    """How a difference of two labels is named."""

    choice_deg: float = limit(
        25.0,
        unit="deg",
        source="such a rotation is a wrong orientation, not an inaccuracy",
    )
    """a rotation this close to 180 or 90 degrees is a wrong orientation"""
    worth_telling: float = limit(0.5, source=NOT_RECORDED)
    """parts below this fraction of the largest one are not mentioned"""
    near_axis_deg: float = limit(15.0, unit="deg", source=NOT_RECORDED)
    """within this angle a rotation is reported as about an axis of the mesh"""


@dataclass(frozen=True, eq=False)
class PoseDifference:
    """Difference of two poses of one object in one camera. Symmetric variants count as equal.

    Attributes:
        mssd_m: largest distance between corresponding surface points, metres.
        rotation_rad: angle between the orientations.
        translation_m: distance between the object's centres.
        along_ray_m: its component along the viewing ray; positive if the second pose is farther.
        sideways_m: its component across the viewing ray.
        shift_px: largest image distance of corresponding surface points; NaN if none is in front
            of the camera.
        turn: (3,) rotation vector from the first to the second pose, mesh frame, radians.
        turn_m: surface displacement by that rotation alone, metres.
    """

    mssd_m: float
    rotation_rad: float
    translation_m: float
    along_ray_m: float
    sideways_m: float
    shift_px: float
    turn: Array
    turn_m: float


def pose_difference(
    T_a: SE3,
    T_b: SE3,
    points: NDArray[np.floating],
    symmetry: Symmetry,
    *,
    cameras: tuple[Camera, Camera] | None = None,
) -> PoseDifference:
    """Compare two poses of one object; exchanging them only changes signs.

    Args:
        T_a, T_b: mesh frame to the camera, metres.
        points: (P, 3) hull vertices of the mesh, mesh frame, metres.
        symmetry: symmetry of the object, mesh frame.
        cameras: intrinsics with which each was annotated; without them there is no `shift_px`.
    """
    X = np.asarray(points, dtype=np.float64)
    centre = fixed_point(symmetry, (X.min(axis=0) + X.max(axis=0)) / 2)
    at_a, at_b = T_a @ centre, T_b @ centre
    # The ray to the midpoint, so that the result is symmetric in the two poses.
    ray = (at_a + at_b) / 2
    ray = ray / max(float(np.linalg.norm(ray)), 1e-12)
    along = float((at_b - at_a) @ ray)
    variant = nearest_variant(T_a, T_b, X, symmetry)
    relative = variant.R.T @ T_b.R
    return PoseDifference(
        mssd_m=surface_distance(T_a, T_b, X, symmetry),
        rotation_rad=rotation_error(T_a, T_b, symmetry),
        translation_m=float(np.linalg.norm(at_b - at_a)),
        along_ray_m=along,
        sideways_m=float(np.linalg.norm(at_b - at_a - along * ray)),
        shift_px=_shift_px(T_a, T_b, X, symmetry, cameras),
        turn=so3_log(relative),
        turn_m=float(np.linalg.norm((X - centre) @ (relative - np.eye(3)).T, axis=1).max()),
    )


# Turns about an axis of rotational symmetry that are tried.
_TURNS = 72


def surface_distance(T_a: SE3, T_b: SE3, points: NDArray[np.floating], symmetry: Symmetry) -> float:
    """Return the MSSD in metres, symmetric in the two poses.

    A mesh is never exactly as symmetric as its object, so the values from T_a to T_b and from T_b
    to T_a differ slightly. The larger one is returned.
    """
    forth = mssd(T_a, T_b, points, symmetry, steps=_TURNS)
    if symmetry.is_trivial:
        return forth
    return max(forth, mssd(T_b, T_a, points, symmetry, steps=_TURNS))


def what_differs(difference: PoseDifference, names: tuple[str, str] = ("A", "B")) -> str:
    """Return a short text on the main difference of two poses, for review.

    Args:
        names: annotators of the first and the second pose.
    """
    limits = DifferenceSettings.current()
    degrees = float(np.rad2deg(np.linalg.norm(difference.turn)))
    axis = _axis_name(difference.turn)
    if degrees >= 180 - limits.choice_deg:
        return f"{degrees:.0f} deg about {axis}: flip?"
    if abs(degrees - 90) <= limits.choice_deg:
        return f"{degrees:.0f} deg about {axis}: a quarter turn?"
    along = difference.along_ray_m
    parts = [
        (
            abs(along),
            f"{1000 * abs(along):.1f} mm along the viewing ray ({names[along > 0]} is farther)",
        ),
        (difference.sideways_m, f"{1000 * difference.sideways_m:.1f} mm sideways"),
        (
            difference.turn_m,
            f"{degrees:.1f} deg about {axis} (moves the surface {1000 * difference.turn_m:.1f} mm)",
        ),
    ]
    parts.sort(key=lambda part: -part[0])
    largest = [
        text for size, text in parts if size >= limits.worth_telling * parts[0][0] and size > 0
    ]
    return ", ".join(largest[:2])


def _shift_px(
    T_a: SE3, T_b: SE3, X: Array, symmetry: Symmetry, cameras: tuple[Camera, Camera] | None
) -> float:
    if cameras is None:
        return float("nan")
    camera_a, camera_b = cameras
    shifts = []
    for first, second in (
        (nearest_variant(T_a, T_b, X, symmetry), T_b),
        (T_a, nearest_variant(T_b, T_a, X, symmetry)),
    ):
        apart = camera_a.project(first @ X) - camera_b.project(second @ X)
        shifts.append(np.linalg.norm(apart, axis=1))
    seen = np.concatenate(shifts)
    return float(np.nanmax(seen)) if np.isfinite(seen).any() else float("nan")


def _axis_name(turn: Array) -> str:
    length = float(np.linalg.norm(turn))
    if length < 1e-12:
        return "no axis"
    axis = turn / length
    index = int(np.abs(axis).argmax())
    if abs(axis[index]) >= np.cos(np.deg2rad(DifferenceSettings.current().near_axis_deg)):
        return "xyz"[index]
    return "(" + " ".join(f"{x:.2f}" for x in axis) + ")"
