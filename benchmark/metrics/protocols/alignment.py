"""Scale and shift of depth that is known only up to both, by least squares in depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.depth.figures import usable

# Below this share of the mean square, predictions are one number, which no scale explains.
_SAME = 1e-9


@dataclass(frozen=True)
class Line:
    """True depth is about `scale` times the prediction plus `shift` metres."""

    scale: float
    shift: float

    def of(self, restored: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return metres; a pixel without a prediction keeps none.

        >>> Line(2.0, 0.5).of(np.array([[0.25, 0.0, np.nan]])).tolist()
        [[1.0, 0.0, 0.0]]
        """
        there = usable(restored)
        metres = self.scale * np.where(there, restored, 0).astype(np.float64) + self.shift
        return np.where(there, metres, 0).astype(np.float32)


@dataclass(frozen=True)
class PairSums:
    """Sums over pixels that have both depths; those of several frames add up.

    Attributes:
        count: number of pixels.
        p, t, pp, pt: sums of predictions, true metres, and products.
    """

    count: int = 0
    p: float = 0.0
    t: float = 0.0
    pp: float = 0.0
    pt: float = 0.0

    @classmethod
    def of(cls, restored: NDArray[np.floating], true: NDArray[np.floating]) -> PairSums:
        """Return the sums of some pixels.

        Args:
            restored: predictions of any unit; those not finite or not positive count as missing.
            true: (same shape) metres, all finite.
        """
        there = usable(restored)
        p, t = restored[there].astype(np.float64), true[there].astype(np.float64)
        return cls(len(p), float(p.sum()), float(t.sum()), float(p @ p), float(p @ t))

    def __add__(self, other: PairSums) -> PairSums:
        return PairSums(
            self.count + other.count,
            self.p + other.p,
            self.t + other.t,
            self.pp + other.pp,
            self.pt + other.pt,
        )

    @property
    def line(self) -> Line:
        """The line with the least squares whose scale is not negative.

        The scale is 0 for equal predictions, and for those that grow where depth falls.

        >>> PairSums.of(np.array([1.0, 2.0]), np.array([2.5, 4.5])).line
        Line(scale=2.0, shift=0.5)
        """
        if not self.count:
            return Line(0.0, 0.0)
        spread = self.pp - self.p * self.p / self.count
        scale = 0.0
        if spread > _SAME * self.pp:
            scale = max(0.0, (self.pt - self.p * self.t / self.count) / spread)
        return Line(scale, (self.t - scale * self.p) / self.count)
