"""Options of the local stereo matcher, and the window sums that both backends use."""

import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError

# A pixel's winner is stored as cost * DISPARITIES + disparity in 32 bits; see `winners`.
DISPARITIES = 512

# Cost of one pixel and disparity before aggregation: up to 48 differing bits, or this many steps
# of 1 - correlation.
ZNCC_STEPS = 4096

# Foot of the gaussian in 1 - correlation, determined on dots 1.6 to 2.6 px wide. Beside its peak
# the correlation of a dot pattern is negative.
GAUSSIAN_FOOT = 1.3

# Standard deviation, in grey levels, added to that of every window. Without it the noise of
# textureless regions would correlate by chance as strongly as a pattern does.
NOISE_LEVELS = 1.0


class Cost(enum.StrEnum):
    """Measure of similarity."""

    CENSUS = "census"
    ZNCC = "zncc"


class Subpixel(enum.StrEnum):
    """Curve through the costs of the winner and its two neighbours.

    On dots two pixels wide the error is periodic in the disparity with a period of one pixel. Its
    worst mean over a tenth of a pixel was measured (`perf/stereo.py`) as

    ============  ======  =====
    curve         census  ZNCC
    ============  ======  =====
    quadratic     0.09    0.03
    equiangular   0.01    0.05
    gaussian      -       0.005
    ============  ======  =====
    """

    AUTO = "auto"
    QUADRATIC = "quadratic"
    EQUIANGULAR = "equiangular"
    GAUSSIAN = "gaussian"
    NONE = "none"


class Backend(enum.StrEnum):
    """Compiled code on the CPU, or tensors on any device of torch."""

    NUMBA = "numba"
    TORCH = "torch"


@dataclass(frozen=True, kw_only=True)
class LocalMatcherOptions:
    """Options of the local matcher. The defaults are closest to a D415's own depth.

    Attributes:
        cost: of a single pixel: census of 7x7 pixels, or correlation of a window.
        zncc_px: side of the correlation's window.
        aggregation_px: side of the square over which costs are summed.
        min_disparity, max_disparity: pixels, both included. The first and the last are never
            winners: the sub-pixel fit needs both neighbours.
        subpixel: curve through the winner and its neighbours; auto takes the one with the least
            bias, equiangular for census and gaussian for ZNCC.
        uniqueness_percent: the second best minimum must cost at least this much more.
        left_right_px: largest difference from the right image's winner; None: not checked.
        median_px: side of the median filter on valid disparities; 1: none.
        speckle_px: smaller connected patches are removed; 0: none.
        speckle_step_px: neighbours whose disparities differ by more are not connected.
        backend: numba or torch; the results are equal.
        device: of torch, such as cuda; None: the first GPU, otherwise the CPU.
        threads: of the numba backend; None: one per core.
    """

    cost: Cost = Cost.CENSUS
    zncc_px: int = 7
    aggregation_px: int = 9
    min_disparity: int = 3
    max_disparity: int = 110
    subpixel: Subpixel = Subpixel.AUTO
    uniqueness_percent: int = 5
    left_right_px: int | None = 1
    median_px: int = 3
    speckle_px: int = 100
    speckle_step_px: float = 1.0
    backend: Backend = Backend.NUMBA
    device: str | None = None
    threads: int | None = None

    def __post_init__(self) -> None:
        for name, kind in (("cost", Cost), ("subpixel", Subpixel), ("backend", Backend)):
            try:
                object.__setattr__(self, name, kind(getattr(self, name)))
            except ValueError:
                raise ToolkitError(
                    f"must be one of {', '.join(kind)}", field=name, value=getattr(self, name)
                ) from None
        self._check_odd("zncc_px", 3, 13)
        self._check_odd("aggregation_px", 1, 21)
        self._check_odd("median_px", 1, 9)
        if not 0 <= self.min_disparity <= self.max_disparity - 2:
            raise ToolkitError(
                "the disparity range needs at least three values, from 0 on",
                field="max_disparity",
                value=(self.min_disparity, self.max_disparity),
            )
        if self.max_disparity - self.min_disparity >= DISPARITIES:
            raise ToolkitError(
                f"the disparity range is longer than {DISPARITIES} pixels",
                field="max_disparity",
                value=(self.min_disparity, self.max_disparity),
                hint="match smaller images",
            )
        if not 0 <= self.uniqueness_percent < 100:
            raise ToolkitError(
                "must be 0 to 99", field="uniqueness_percent", value=self.uniqueness_percent
            )
        for name in ("left_right_px", "speckle_px", "speckle_step_px"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise ToolkitError("must not be negative", field=name, value=value)
        if self.threads is not None and self.threads < 1:
            raise ToolkitError("must be at least 1", field="threads", value=self.threads)
        if self.cost is Cost.CENSUS and self.subpixel is Subpixel.GAUSSIAN:
            raise ToolkitError(
                "a gaussian is the shape of a correlation, not of a census",
                field="subpixel",
                value=str(self.subpixel),
            )

    @property
    def curve(self) -> Subpixel:
        """The sub-pixel curve, with `auto` resolved."""
        if self.subpixel is not Subpixel.AUTO:
            return self.subpixel
        return Subpixel.EQUIANGULAR if self.cost is Cost.CENSUS else Subpixel.GAUSSIAN

    @property
    def gaussian_foot(self) -> int:
        """`GAUSSIAN_FOOT` as an aggregated cost."""
        return round(GAUSSIAN_FOOT * ZNCC_STEPS) * self.aggregation_px**2

    @property
    def count(self) -> int:
        """Number of disparities searched."""
        return self.max_disparity - self.min_disparity + 1

    def _check_odd(self, name: str, low: int, high: int) -> None:
        value = getattr(self, name)
        if not (low <= value <= high and value % 2 == 1):
            raise ToolkitError(
                f"must be an odd number from {low} to {high}", field=name, value=value
            )


def window_sums(padded: NDArray[np.uint8], size: int) -> tuple[NDArray[np.int32], Array]:
    """Sum of every window of size x size, and 1 / (pixels times standard deviation).

    Args:
        padded: (H + size - 1, W + size - 1).

    Returns:
        (H, W) int32 and (H, W) float64.
    """
    values = padded.astype(np.int64)
    total, squares = _box(values, size), _box(values * values, size)
    pixels = size * size
    spread = pixels * squares - total * total + (NOISE_LEVELS * pixels) ** 2
    return total.astype(np.int32), 1.0 / np.sqrt(spread.astype(np.float64))


def _box(values: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    for axis in (0, 1):
        sums = np.cumsum(values, axis=axis)
        sums = np.insert(sums, 0, 0, axis=axis)
        end = sums.shape[axis]
        values = np.take(sums, range(size, end), axis) - np.take(sums, range(end - size), axis)
    return values
