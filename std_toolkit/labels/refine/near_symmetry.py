"""The axis about which a mesh is round but for a part of it, such as a mug but for its handle.

From a start that is turned too far about it, following edges fits the round body to a pixel, and
the rest stays where it is: nothing near it tells where it belongs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.labels.refine.problem import RefineObject

Array = NDArray[np.float64]

# Faces that look along the axis say nothing.
_SIDEWAYS = 0.5
# A face belongs to the round body if its normal passes the axis within this share of the radius.
_CLOSE = 0.03
# Shares of the sideways surface that is round: less is another shape, more shows no turn.
_ROUND, _WHOLLY_ROUND = 0.6, 0.985
_ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Axis:
    """A line in the mesh frame: a unit vector, and a point (3,) in metres."""

    direction: Array
    point: Array

    def turned(self, T: SE3, angle: float) -> SE3:
        """A pose after a turn of the object about the line, radians."""
        R = so3_exp(self.direction * angle)
        return T @ SE3(R, self.point - R @ self.point)


def near_symmetry(thing: RefineObject) -> Axis | None:
    """The axis about which most of the surface is round, but not all; along x, y, or z.

    None also where the object is declared symmetric: what shows a turn then is not its shape.
    """
    if thing.symmetry.continuous:
        return None
    corners = thing.vertices[thing.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    some = area > 0
    normals, middles, area = cross[some] / area[some, None], corners[some].mean(axis=1), area[some]
    found: list[tuple[float, Axis]] = []
    for k in range(3):
        i, j = (m for m in range(3) if m != k)
        n, x = normals[:, [i, j]], middles[:, [i, j]]
        length = np.linalg.norm(n, axis=1)
        sideways = length > _SIDEWAYS
        if not sideways.any():
            continue
        n, x, weight = n[sideways] / length[sideways, None], x[sideways], area[sideways]
        across = np.column_stack([-n[:, 1], n[:, 0]])
        point = _common_point(across, x, weight, _CLOSE * thing.radius)
        miss = np.abs((across * (x - point)).sum(axis=1))
        share = float(weight[miss < _CLOSE * thing.radius].sum() / weight.sum())
        if _ROUND < share < _WHOLLY_ROUND:
            place = thing.centre.copy()
            place[[i, j]] = point
            found.append((share, Axis(np.eye(3)[k], place)))
    return max(found, key=lambda f: f[0])[1] if found else None


def _common_point(across: Array, x: Array, weight: Array, close: float) -> Array:
    """(2,) the point that most of the lines through x (N, 2), normal to across (N, 2), pass."""
    offset = (across * x).sum(axis=1)
    robust = np.ones(len(x))
    spread = 8 * close
    point = np.zeros(2)
    for _ in range(_ROUNDS):
        w = weight * robust
        A = (across * w[:, None]).T @ across + 1e-12 * w.sum() * np.eye(2)
        point = np.linalg.solve(A, (across * w[:, None]).T @ offset)
        robust = 1 / (1 + ((across @ point - offset) / spread) ** 2) ** 2
        spread = max(spread / 2, close)
    return np.asarray(point)
