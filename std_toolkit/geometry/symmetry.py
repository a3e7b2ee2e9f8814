"""Symmetries of an object, in its mesh frame."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp


@dataclass(frozen=True)
class Symmetry:
    """Transforms that leave an object looking the same (BOP's definition).

    The discrete transforms must be complete, as in BOP: no products of them are formed.

    Attributes:
        discrete: 4x4 transforms, row-major 16 numbers each, identity left out, metres.
        continuous: (axis, offset) pairs: any rotation about `axis` through `offset` (metres).
            The axes of a sphere go through its centre.
    """

    discrete: tuple[tuple[float, ...], ...] = ()
    continuous: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()

    def __post_init__(self) -> None:
        for T in self.discrete:
            SE3.from_matrix(T)
        for axis, offset in self.continuous:
            if not np.isclose(np.linalg.norm(axis), 1, atol=1e-4):
                raise ToolkitError("a symmetry axis must have length 1", field="axis", value=axis)
            if not np.isfinite(offset).all():
                raise ToolkitError("is not finite", field="offset", value=offset)

    @property
    def is_trivial(self) -> bool:
        return not self.discrete and not self.continuous

    def transforms(self, steps: int = 72) -> list[SE3]:
        """All symmetry transforms T_obj_obj, the identity first.

        Args:
            steps: samples of a full turn for continuous symmetries. 72 steps of 5 degrees leave
                at most 2.5 degrees: 1.3 mm on a radius of 30 mm.
        """
        discrete = self.discrete_transforms()
        if not self.continuous:
            return discrete
        angles = 2 * np.pi * np.arange(steps) / steps
        turns = [self.turn(i, float(a)) for i in range(len(self.continuous)) for a in angles]
        return [d @ c for d, c in product(discrete, turns)]

    def discrete_transforms(self) -> list[SE3]:
        """The discrete transforms T_obj_obj, the identity first."""
        return [SE3.identity(), *(SE3.from_matrix(T) for T in self.discrete)]

    def turn(self, index: int, angle: float) -> SE3:
        """Rotation by `angle` radians about continuous axis `index`."""
        axis, offset = (np.asarray(v, dtype=np.float64) for v in self.continuous[index])
        R = so3_exp(axis / np.linalg.norm(axis) * angle)
        return SE3(R, offset - R @ offset)

    @property
    def is_spherical(self) -> bool:
        """Two axes of full turns that are not parallel: every rotation looks the same."""
        axes = np.array([axis for axis, _ in self.continuous], dtype=np.float64)
        return len(axes) > 1 and bool(
            np.linalg.norm(np.cross(axes[0], axes[1:]), axis=1).max() > 1e-3
        )
