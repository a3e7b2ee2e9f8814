"""Places of an object by one source or several: motions with covariances, and their products.

Motions are vectors (6,): translation of the object's centre in mm, and rotation vector about it in
degrees, along the axes of the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.result import Value
from std_toolkit.settings import Settings, limit

_SAMPLES = 4000
# Covariances are filed with six digits.
ROUNDING = 1e-5
SHIFT, TURN = slice(3), slice(3, 6)


@dataclass(frozen=True, kw_only=True)
class AgreementSettings(Settings):
    """When two sources disagree."""

    known: float = limit(
        20.0, unit="mm, deg", source="support leaves 30 mm and 17 deg where it says nothing"
    )
    """directions with a larger joint deviation are not compared"""
    chance: float = limit(0.0027, source="three deviations")
    """sources disagree that differ as much by chance as rarely"""


@dataclass(frozen=True, eq=False)
class Located:
    """Where the evidence puts an object.

    Attributes:
        motion: (6,) most likely motion from the label.
        covariance: (6, 6) of it.
    """

    motion: Array
    covariance: Array

    @property
    def mm(self) -> tuple[float, float]:
        """Length of the translation, and the largest standard deviation of one."""
        return self._part(SHIFT)

    @property
    def deg(self) -> tuple[float, float]:
        """The same of the rotation."""
        return self._part(TURN)

    def _part(self, part: slice) -> tuple[float, float]:
        block = self.covariance[part, part]
        largest = float(np.linalg.eigvalsh((block + block.T) / 2)[-1])
        return float(np.linalg.norm(self.motion[part])), float(np.sqrt(max(largest, 0.0)))

    def along(self, part: slice) -> float:
        """Standard deviation along the motion; the largest one without a motion."""
        length, largest = self._part(part)
        if length < 1e-9:
            return largest
        unit = self.motion[part] / length
        return float(np.sqrt(max(float(unit @ self.covariance[part, part] @ unit), 0.0)))


@dataclass(frozen=True, eq=False)
class Scatter:
    """Covariances of errors in all directions that the symmetry of an object does not undo."""

    kept: Array

    @staticmethod
    def of(located: Located) -> Scatter:
        """In the directions that a source knows something of."""
        values, axes = np.linalg.eigh((located.covariance + located.covariance.T) / 2)
        least = ROUNDING * max(float(values[-1]), 1e-12)
        known = axes[:, values > least]
        return Scatter(known @ known.T)

    def __call__(self, mm: float, deg: float) -> Array:
        return self.kept @ np.diag(np.array([mm] * 3 + [deg] * 3) ** 2) @ self.kept


def log_density(x: Array, covariance: Array) -> float:
    """Logarithm of a normal density, up to a constant."""
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    values = np.maximum(values, 1e-6)
    return float(-0.5 * ((axes.T @ x) ** 2 / values + np.log(values)).sum())


def joined(a: Located, b: Located) -> Located:
    """Two measurements weighted by their inverse covariances."""
    A, B = (np.linalg.inv(s.covariance + 1e-8 * np.eye(6)) for s in (a, b))
    covariance = np.linalg.inv(A + B)
    covariance = (covariance + covariance.T) / 2
    return Located(covariance @ (A @ a.motion + B @ b.motion), covariance)


@cache
def _normal_samples() -> Array:
    half = np.random.default_rng(0).normal(size=(_SAMPLES // 2, 6))
    return np.concatenate([half, -half])


def shares_within(located: Located, mm: float, deg: float) -> Array:
    """(3,) probabilities that the motion is within both limits, and within each of them."""
    values, axes = np.linalg.eigh((located.covariance + located.covariance.T) / 2)
    motions = located.motion + _normal_samples() @ (axes * np.sqrt(np.maximum(values, 0))).T
    far, turned = (np.linalg.norm(motions[:, part], axis=1) for part in (SHIFT, TURN))
    near, level = far <= mm, turned <= deg
    return np.array([(near & level).mean(), near.mean(), level.mean()])


def disagree(a: Located, b: Located) -> bool:
    """Whether two sources differ by more than chance explains."""
    from scipy.special import chdtri  # the inverse of chi square; scipy.stats loads for a second

    values, axes = np.linalg.eigh(a.covariance + b.covariance)
    # What neither knows, or a symmetry leaves open, is left out.
    limits = AgreementSettings.current()
    least = ROUNDING * float(values[-1])
    known = (values > least) & (values < limits.known**2)
    if not known.any():
        return False
    apart = (axes.T @ (a.motion - b.motion))[known]
    return bool((apart**2 / values[known]).sum() > chdtri(int(known.sum()), limits.chance))


def located_by(value: Value | None) -> Located | None:
    """The motion of a value of the report; None if it has none."""
    if value is None or value.motion is None or value.covariance is None:
        return None
    filed = np.reshape(value.covariance, (6, 6))
    # Filed numbers are rounded: what a symmetry leaves open has no variance, or less.
    values, axes = np.linalg.eigh((filed + filed.T) / 2)
    least = ROUNDING * max(float(values[-1]), 0.0)
    values = np.where(values > least, values, 0.0)
    return Located(np.array(value.motion), (axes * values) @ axes.T)
