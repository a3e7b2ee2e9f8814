"""Counts and sums of depth errors by cell, in one pass over the compared pixels.

A cell is any class of pixels (an object, an object's edge); the errors of every union of cells
follow from the sums without another look at the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.missing import THRESHOLDS, Missing, check_reportable

NAMES = ("rmse", "rel", "mae", "d105", "d110", "d125")


@dataclass(frozen=True)
class Errors:
    """Depth errors of one set of pixels; NaN where it has none.

    Attributes:
        n_pixels: compared pixels; n_answered: those whose prediction is finite and positive.
        rmse, mae: metres; rel: mean of error / true depth; d105, d110, d125: share of pixels whose
            ratio to the truth is below 1.05, 1.10, 1.25; all with missing pixels as asked for.
        coverage: n_answered / n_pixels.
        rmse_answered ... d125_answered: the same over the answered pixels alone.
    """

    n_pixels: int
    n_answered: int
    rmse: float
    rel: float
    mae: float
    d105: float
    d110: float
    d125: float
    coverage: float
    rmse_answered: float
    rel_answered: float
    mae_answered: float
    d105_answered: float
    d110_answered: float
    d125_answered: float

    def as_dict(self) -> dict[str, int | float]:
        """Values by name, in the order above."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True)
class Tally:
    """Counts and sums by cell (first axis) and by whether the prediction is usable (second).

    Attributes:
        counts: (cells, 2, 4) pixels; the last axis tells how many thresholds they pass.
        sums: (cells, 2, 3) sums of squared, absolute and relative error.
    """

    counts: NDArray[np.int64]
    sums: NDArray[np.float64]

    def __add__(self, other: Tally) -> Tally:
        return Tally(self.counts + other.counts, self.sums + other.sums)

    def of(self, cells: NDArray[np.integer] | slice) -> Errors:
        """Errors over the union of some cells.

        Args:
            cells: indices of distinct cells.

        Returns:
            The errors; those of missing pixels as they were counted.
        """
        # Cells are picked, not weighted with 0 and 1: a NaN of another cell must not come in.
        counts, sums = self.counts[cells].sum(axis=0), self.sums[cells].sum(axis=0)
        every = _means(counts.sum(axis=0), sums.sum(axis=0))
        answered = _means(counts[1], sums[1])
        n, n_answered = int(counts.sum()), int(counts[1].sum())
        coverage = n_answered / n if n else float("nan")
        return Errors(
            n,
            n_answered,
            **dict(zip(NAMES, every, strict=True)),
            coverage=coverage,
            **{f"{name}_answered": x for name, x in zip(NAMES, answered, strict=True)},
        )


def tally(
    pred: NDArray[np.floating],
    true: NDArray[np.floating],
    cell: NDArray[np.integer],
    n_cells: int,
    missing: Missing = Missing.COUNTED,
) -> Tally:
    """Count and sum the errors of pixels by cell.

    Args:
        pred: (N,) predicted metres, anything where there is none.
        true: (N,) true metres, finite and positive.
        cell: (N,) cell of each pixel, below `n_cells`.
        n_cells: number of cells.
        missing: `COUNTED` or `AS_GIVEN`; the errors over answered pixels come with either.

    Returns:
        The tally. Ratios have the precision of the depths (float32, as in the released
        evaluations, or float64), sums always float64.

    Raises:
        ToolkitError: `LEFT_OUT`.

    >>> t = tally(np.array([1.02, 0]), np.array([1.0, 2.0]), np.array([0, 1]), 2)
    >>> t.of(slice(None)).rel, t.of([0]).d105, t.of([1]).coverage
    (0.51, 1.0, 0.0)
    """
    check_reportable(missing)
    p, g = as_real(pred), as_real(true)
    usable = (p > 0) & (p < np.inf)
    if missing is not Missing.AS_GIVEN:
        p = np.where(usable, p, p.dtype.type(0))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        worst = p / g
        np.maximum(worst, g / p, out=worst)
        passed = (worst < THRESHOLDS[2]).view(np.uint8)
        for limit in THRESHOLDS[:2]:
            passed = passed + (worst < limit)
        error = np.subtract(p, g, dtype=np.float64)
        np.abs(error, out=error)
        relative = error / g
        squared = np.square(error)
    key = cell.astype(np.intp) * 2 + usable
    counts = np.bincount(key * 4 + passed, minlength=n_cells * 8)
    sums = np.empty((n_cells * 2, 3))
    for i, weights in enumerate((squared, error, relative)):
        sums[:, i] = np.bincount(key, weights, n_cells * 2)
    return Tally(
        counts.astype(np.int64, copy=False).reshape(n_cells, 2, 4), sums.reshape(n_cells, 2, 3)
    )


def as_real(depth: NDArray[np.floating]) -> NDArray[np.floating]:
    """Depth as it is computed with.

    Args:
        depth: metres of any floating-point type.

    Returns:
        float64 as it is, shorter types as float32.

    >>> as_real(np.zeros(2, np.float16)).dtype
    dtype('float32')
    """
    return depth if depth.dtype == np.float64 else depth.astype(np.float32, copy=False)


def _means(counts: NDArray[np.int64], sums: NDArray[np.float64]) -> tuple[float, ...]:
    """RMSE, REL, MAE and the three deltas from counts by thresholds passed and from sums."""
    n = int(counts.sum())
    if n == 0:
        return (float("nan"),) * 6
    squared, absolute, relative = (float(s) / n for s in sums)
    # A pixel that passes the threshold of 1.10 passes that of 1.25, too.
    deltas = (float(counts[least:].sum()) / n for least in (3, 2, 1))
    return (squared**0.5, relative, absolute, *deltas)
