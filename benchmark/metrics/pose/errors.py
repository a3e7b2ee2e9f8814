"""Angles and distances between poses, pair by pair."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def rotation_errors_deg(
    RT_a: Floats,
    RT_b: Floats,
    *,
    round_about_y: Mask | None = None,
    upside_down: Mask | None = None,
) -> Floats:
    """Angles between the rotations of poses.

    Taken from sine and cosine together: the angle is that of the clipped arc cosine which
    evaluations use, but exact near 0 as well, and never NaN.

    Args:
        RT_a, RT_b: (N, 4, 4) object to camera, a positive scale inside.
        round_about_y: (N,) objects that look the same after any turn about y: only the directions
            of the y axes are compared. None by default.
        upside_down: (N,) of those, the ones that look the same with top and bottom exchanged.

    Returns:
        (N,) degrees in [0, 180].

    Raises:
        ToolkitError: shapes that do not belong together.

    >>> from benchmark.metrics.pose.boxes import turned_about_y
    >>> one, turned = turned_about_y(np.eye(4)[None], 4)[0, :2, None]
    >>> rotation_errors_deg(one, turned).round(9).tolist()
    [90.0]
    >>> rotation_errors_deg(one, turned, round_about_y=np.array([True])).tolist()
    [0.0]
    """
    a, b = _pairs(RT_a, RT_b)
    turning = _mask(round_about_y, len(a), "round_about_y")
    flipping = _mask(upside_down, len(a), "upside_down")
    Ra, Rb = (x[:, :3, :3] / np.cbrt(np.linalg.det(x[:, :3, :3]))[:, None, None] for x in (a, b))
    relative = Ra.transpose(0, 2, 1) @ Rb
    skew = relative - relative.transpose(0, 2, 1)
    sine = np.sqrt((skew**2).sum(axis=(1, 2)) / 8)
    cosine = (np.trace(relative, axis1=1, axis2=2) - 1) / 2
    ya, yb = Ra[:, :, 1], Rb[:, :, 1]
    sine_y = np.linalg.norm(np.cross(ya, yb), axis=1)
    cosine_y = (ya * yb).sum(axis=1)
    cosine_y = np.where(flipping, np.abs(cosine_y), cosine_y)
    angle = np.arctan2(np.where(turning, sine_y, sine), np.where(turning, cosine_y, cosine))
    return np.rad2deg(angle)


def translation_errors_cm(RT_a: Floats, RT_b: Floats) -> Floats:
    """Distances between the centres of poses.

    Args:
        RT_a, RT_b: (N, 4, 4) object to camera, metres.

    Returns:
        (N,) centimetres.

    Raises:
        ToolkitError: shapes that do not belong together.

    >>> moved = np.eye(4)[None].copy()
    >>> moved[0, :3, 3] = 0.03, 0.0, 0.04
    >>> translation_errors_cm(np.eye(4)[None], moved).tolist()
    [5.0]
    """
    a, b = _pairs(RT_a, RT_b)
    return 100 * np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1)


def _pairs(RT_a: Floats, RT_b: Floats) -> tuple[Floats, Floats]:
    a, b = np.asarray(RT_a, dtype=np.float64), np.asarray(RT_b, dtype=np.float64)
    if a.shape != b.shape or a.shape[1:] != (4, 4):
        raise ToolkitError("needs two equal arrays (N, 4, 4)", value=(a.shape, b.shape))
    return a, b


def _mask(mask: Mask | None, n: int, name: str) -> Mask:
    found = np.zeros(n, dtype=bool) if mask is None else np.asarray(mask)
    if found.shape != (n,):
        raise ToolkitError("must have shape (N,)", field=name, value=found.shape)
    return found
