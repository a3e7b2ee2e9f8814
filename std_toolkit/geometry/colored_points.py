"""Colours on a surface: the part of its symmetries that they keep."""

from collections.abc import Sequence

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.geometry.se3 import SE3, rotation_angle
from std_toolkit.geometry.symmetry import Symmetry, closed_group
from std_toolkit.geometry.turned_surface import SAME_AXIS

# Orders of axes that are looked for, and angles about an axis that no regular polygon of few
# corners repeats after.
FOLDS = (12, 10, 9, 8, 7, 6, 5, 4, 3, 2)
GENERIC = tuple(2 * np.pi * x for x in (0.093, 0.269, 0.382, 0.41, 0.477))

# Colours are averaged within this distance, in parts of the diagonal: after a turn, fine print of
# an inexact mesh does not lie on itself.
_BLUR = 0.02

# Colours differ, in grey levels, and the part of the surface that may differ: shading, dirt, grain.
_OTHER_COLOR, _OTHER_SHARE = 40.0, 0.125


class ColoredPoints:
    """Points on a surface with the colours around them.

    Args:
        points: (N, 3) metres; normals: (N, 3) unit; colors: (N, 3) RGB 0 to 255.
        diagonal: of the surface's bounding box, metres.
    """

    def __init__(self, points: Array, normals: Array, colors: Array, diagonal: float) -> None:
        from scipy.spatial import cKDTree

        self._points, self._normals = points, normals
        self._tree = cKDTree(points)
        self._radius = _BLUR * diagonal
        near = self._tree.query_ball_point(points, self._radius)
        self._colors = np.stack(
            [
                colors[k][normals[k] @ n > 0.5].mean(axis=0) if len(k) > 1 else colors[k[0]]
                for k, n in zip(near, normals, strict=True)
            ]
        )

    def other_share(self, turn: SE3) -> float:
        """Part of the surface whose colours differ after a turn."""
        distance, nearest = self._tree.query(turn @ self._points)
        facing = ((self._normals @ turn.R.T) * self._normals[nearest]).sum(axis=1) > 0.5
        compared = facing & (distance < 2 * self._radius)
        if not compared.any():
            return 1.0
        apart = np.abs(self._colors - self._colors[nearest]).max(axis=1)
        return float((apart[compared] > _OTHER_COLOR).mean())

    def kept(self, shape: Symmetry) -> Symmetry:
        """The part of a shape's symmetries after which the colours are the same."""
        if shape.is_trivial:
            return shape

        def keeps(turn: SE3) -> bool:
            return self.other_share(turn) <= _OTHER_SHARE

        if shape.is_spherical:
            free = [k for k in range(len(shape.continuous)) if self._keeps_axis(shape, k)]
            if len(free) == len(shape.continuous):
                return shape
            return Symmetry(continuous=tuple(shape.continuous[k] for k in free))
        if shape.continuous:
            if self._keeps_axis(shape, 0):
                kept = [T for T in shape.discrete_transforms()[1:] if keeps(T)]
                return Symmetry(tuple(tuple(T.flat()) for T in kept), shape.continuous)
            for order in FOLDS:
                turns = [shape.turn(0, 2 * np.pi * k / order) for k in range(1, order)]
                if all(keeps(T) for T in turns):
                    return Symmetry(tuple(tuple(T.flat()) for T in turns))
            return Symmetry()
        return _largest_group([T for T in shape.discrete_transforms()[1:] if keeps(T)])

    def _keeps_axis(self, shape: Symmetry, index: int) -> bool:
        return all(self.other_share(shape.turn(index, a)) <= _OTHER_SHARE for a in GENERIC)


def _largest_group(turns: Sequence[SE3]) -> Symmetry:
    """The largest group within the given turns: some of them may pass by chance."""
    best: list[SE3] = []
    for start in [turns, *[[T] for T in turns]]:
        group = closed_group(start)[1:]
        inside = all(any(_same_turn(g, T) for T in turns) for g in group)
        if inside and len(group) > len(best):
            best = group
    return Symmetry(tuple(tuple(T.flat()) for T in best))


def _same_turn(a: SE3, b: SE3) -> bool:
    return rotation_angle(a.R.T @ b.R) < SAME_AXIS
