"""What the expected error of an answer, its spread in metres, is worth.

Selective error: the mean absolute error of the most trusted pixels, those of the smallest spread.
Coverage of spreads: how many errors are at most one and two spreads; 68 % and 95 % of errors that
are normally distributed with this standard deviation.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.depth.figures import usable
from std_toolkit.arrays import Array, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Column

SHARES = (0.5, 0.75, 0.9)  # of the pixels, the most trusted ones

# Classes of pixels whose spread is looked at. `filled`: not measured, and not of glass or metal.
REGIONS = ("glass", "metal", "opaque", "background", "filled")


def _error(name: str, heading: str) -> Column:
    return Column(name=name, heading=heading, unit="mm", factor=1e3, lower_is_better=True)


SELECTIVE = (
    *(_error(f"selective_{100 * s:.0f}", f"MAE of the most trusted {s:.0%}") for s in SHARES),
    _error("selective_area", "area under selective error"),
)
SPREADS = tuple(
    Column(
        name=f"spread{times}_{region}",
        heading=f"{region} within {times} spread{'s' if times > 1 else ''}",
        unit="%",
        factor=100,
    )
    for times in (1, 2)
    for region in REGIONS
)
COLUMNS = (*SELECTIVE, *SPREADS)
NAMES = tuple(column.name for column in COLUMNS)


def selective_errors(error: Array, spread: Array) -> dict[str, float]:
    """Mean absolute errors of the most trusted pixels, and the area under that curve.

    Pixels of equal spread are as good as each other: each counts with their mean error. The area
    is the mean over all shares of the pixels, from the most trusted one to all.

    Args:
        error: (N,) absolute errors, metres.
        spread: (N,) expected errors, metres; infinite where the method vouches for nothing.

    Returns:
        Metres by the names of `SELECTIVE`; NaN without pixels.

    >>> found = selective_errors(np.array([4.0, 1, 3, 2]), np.array([0.4, 0.1, 0.3, 0.2]))
    >>> found["selective_50"], found["selective_area"]
    (1.5, 1.75)
    """
    count = len(error)
    if not count:
        return {column.name: float("nan") for column in SELECTIVE}
    _, group = np.unique(spread, return_inverse=True)
    sizes = np.bincount(group)
    means = np.bincount(group, error) / sizes
    curve = np.cumsum(np.repeat(means, sizes)) / np.arange(1, count + 1)
    values = [curve[max(1, round(share * count)) - 1] for share in SHARES]
    return dict(zip((c.name for c in SELECTIVE), map(float, (*values, curve.mean())), strict=True))


def spread_coverage(error: Array, spread: Array, times: int) -> float:
    """Share in [0, 1] of the errors that are at most `times` spreads.

    Args:
        error: (N,) absolute errors, metres.
        spread: (N,) expected errors, metres.
        times: how many spreads.

    Returns:
        The share; NaN without pixels.

    >>> spread_coverage(np.array([1.0, 3.0]), np.array([2.0, 2.0]), 1)
    0.5
    """
    return float((error <= times * spread).mean()) if len(error) else float("nan")


def trust_figures(
    restored: NDArray[np.floating],
    spread: NDArray[np.floating],
    true: NDArray[np.floating],
    regions: Mapping[str, Mask],
) -> dict[str, float]:
    """All figures of the spread of an answer.

    Args:
        restored: (h, w) answered metres; a pixel without an answer is off by its depth and vouched
            for by nobody.
        spread: (h, w) expected error, metres.
        true: (h, w) true metres, 0 where there is none.
        regions: (h, w) pixels of each of `REGIONS`.

    Returns:
        Figures by the names of `COLUMNS`: errors over all pixels with truth, coverage over the
        answered pixels of a region; NaN without pixels.

    Raises:
        ToolkitError: shapes that differ.

    >>> everywhere = {name: np.ones((1, 2), bool) for name in REGIONS}
    >>> found = trust_figures(
    ...     np.array([[0.51, 0.5]]), np.array([[0.02, 0.001]]), np.array([[0.5, 0.5]]), everywhere
    ... )
    >>> found["selective_50"], found["spread1_glass"]
    (0.0, 1.0)
    """
    if len({a.shape for a in (restored, spread, true, *regions.values())}) > 1:
        raise ToolkitError("answer, spread, truth and regions must have one shape")
    there = usable(true)
    answered = there & usable(restored)
    error = np.abs(np.where(answered, restored, 0).astype(np.float64) - np.where(there, true, 0))
    vouched = np.where(answered & (spread >= 0), spread, np.inf).astype(np.float64)
    found = selective_errors(error[there], vouched[there])
    for times in (1, 2):
        for name in REGIONS:
            where = answered & regions[name]
            found[f"spread{times}_{name}"] = spread_coverage(error[where], vouched[where], times)
    return found
