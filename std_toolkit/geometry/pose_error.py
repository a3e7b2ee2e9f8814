"""Differences between two poses of one object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3, rotation_angle
from std_toolkit.geometry.symmetry import Symmetry

Array = NDArray[np.float64]
_GOLDEN = (np.sqrt(5) - 1) / 2


def rotation_error(estimate: SE3, truth: SE3, symmetry: Symmetry | None = None) -> float:
    """Smallest rotation angle in radians between two poses over the object's symmetries.

    Exact for continuous symmetries too: of the relative rotation, only what does not turn about
    the axis counts.
    """
    symmetry = symmetry or Symmetry()
    if symmetry.is_spherical:
        return 0.0
    errors = []
    for S in symmetry.discrete_transforms():
        relative = SE3((truth.R @ S.R).T @ estimate.R, np.zeros(3))
        errors.append(rotation_angle(relative.R))
        w, *v = relative.quat()
        for axis, _ in symmetry.continuous:
            a = np.asarray(axis) / np.linalg.norm(axis)
            along = float(np.dot(v, a))
            across = float(np.linalg.norm(v - along * a))
            errors.append(2 * float(np.arctan2(across, np.hypot(w, along))))
    return min(errors)


def translation_error(estimate: SE3, truth: SE3) -> float:
    """Distance in metres between the origins of two poses."""
    return float(np.linalg.norm(estimate.t - truth.t))


def mssd(
    estimate: SE3,
    truth: SE3,
    vertices: NDArray[np.floating],
    symmetry: Symmetry | None = None,
    *,
    steps: int = 360,
) -> float:
    """Maximum symmetry-aware surface distance, metres.

    Source: T. Hodan et al., "BOP Challenge 2020", equation 3. The maximum of a linear map's
    length over a mesh is reached at a vertex of its convex hull: passing hull vertices is exact
    and fast.

    Args:
        estimate, truth: T_cam_obj or T_world_obj of both.
        vertices: (V, 3) mesh or hull vertices, object frame, metres.
        symmetry: of the object; none means the identity alone.
        steps: samples of a full turn for continuous symmetries; the best one is refined, so
            that the result does not depend on the sampling.
    """
    symmetry = symmetry or Symmetry()
    relative = truth.inverse() @ estimate  # lengths are the same in any frame
    points = np.asarray(vertices, dtype=np.float64)
    moved = relative @ points
    best = np.inf
    for S in symmetry.discrete_transforms():
        if symmetry.is_spherical:
            centre = np.asarray(symmetry.continuous[0][1])
            best = min(best, float(np.linalg.norm(relative @ centre - S @ centre)))
            continue
        best = min(best, _farthest(moved, S @ points))
        for index in range(len(symmetry.continuous)):
            best = min(best, _over_turns(moved, points, S, symmetry, index, steps))
    return best


def _over_turns(
    moved: Array, points: Array, S: SE3, symmetry: Symmetry, index: int, steps: int
) -> float:
    """Smallest distance over all turns about one axis.

    A point that turns runs on a circle, so its squared distance from a fixed one is a cosine of the
    angle. The search works on these; the distance itself is then taken from the points, because
    cosines that cancel lose digits. What is left is good to some nanometres.
    """
    axis, offset = (np.asarray(v, dtype=np.float64) for v in symmetry.continuous[index])
    axis = axis / np.linalg.norm(axis)
    target, arm = S.inverse() @ moved - offset, points - offset
    along = np.outer(arm @ axis, axis)
    across = arm - along
    constant = ((target - along) ** 2).sum(axis=1) + (across**2).sum(axis=1)
    cosine = 2 * (target * across).sum(axis=1)
    sine = 2 * (target * np.cross(axis, across)).sum(axis=1)

    def squared(angle: float) -> float:
        return float((constant - cosine * np.cos(angle) - sine * np.sin(angle)).max())

    step = 2 * np.pi / steps
    start = step * min(range(steps), key=lambda k: squared(step * k))
    low, high = start - step, start + step
    # Golden section: two thirds of the interval stay in each round; 30 leave a millionth.
    a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_a, at_b = squared(a), squared(b)
    for _ in range(30):
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - _GOLDEN * (high - low)
            at_a = squared(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + _GOLDEN * (high - low)
            at_b = squared(b)
    return min(_farthest(moved, S @ symmetry.turn(index, x) @ points) for x in (start, a, b))


def _farthest(p: Array, q: Array) -> float:
    return float(np.sqrt(((p - q) ** 2).sum(axis=1).max()))
