"""Says in words which direction of a pose is least determined."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import skew
from std_toolkit.geometry.symmetry import Symmetry

Array = NDArray[np.float64]


def covariance_at(covariance: NDArray[np.floating], point: NDArray[np.floating]) -> Array:
    """The 6x6 covariance of a right perturbation, with its translation taken at `point`.

    A rotation about the mesh origin moves an object whose origin lies elsewhere: shifts and turns
    are only told apart about its centre.

    Args:
        point: (3,) in the mesh frame.
    """
    move = np.eye(6)
    move[:3, 3:] = -skew(point)
    return np.asarray(move @ covariance @ move.T, dtype=np.float64)


def weakest_direction(
    covariance: NDArray[np.floating],
    centre: NDArray[np.floating],
    radius: float,
    symmetry: Symmetry,
) -> str:
    """One sentence on the direction in which the surface may be off the most.

    Args:
        covariance: (6, 6) of a right perturbation, metres and radians.
        centre: (3,) of the object, mesh frame.
        radius: metres; turns count with what they move at this distance.
        symmetry: turns about its axes do not count: they change nothing.
    """
    C = covariance_at(covariance, centre)
    size = np.array([1.0] * 3 + [radius] * 3)
    C = C * np.outer(size, size)
    for axis, _ in symmetry.continuous:
        free = np.concatenate([np.zeros(3), axis])
        P = np.eye(6) - np.outer(free, free)
        C = P @ C @ P
    values, vectors = np.linalg.eigh(C)
    v, std = vectors[:, -1], float(np.sqrt(max(values[-1], 0)))
    shift, turn = np.linalg.norm(v[:3]), np.linalg.norm(v[3:])
    if shift >= turn:
        direction, what = v[:3] / shift, "shift along"
        amount = f"{1000 * std:.2f} mm"
    else:
        direction, what = v[3:] / turn, "turn about"
        amount = f"{np.rad2deg(std / radius):.2f} deg"
    # The sign of an eigenvector is chance; a fixed one keeps files reproducible.
    if direction[int(np.argmax(np.abs(direction)))] < 0:
        direction = -direction
    axis_text = ", ".join(f"{x + 0.0:.2f}" for x in np.round(direction, 2))
    return f"least determined: {what} object axis ({axis_text}), standard deviation {amount}"
