"""Counts and sums of depth errors by cell; what a missing prediction counts as.

A cell is any class of pixels (an object, an object's edge). The errors of every union of cells are
computed from the sums without access to the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

THRESHOLDS = (1.05, 1.10, 1.25)  # of delta: the ratio between prediction and truth either way

_AT_ONCE = 1 << 15  # pixels whose intermediate figures stay in the processor's cache

NAMES = ("rmse", "rel", "mae", "d105", "d110", "d125")


class Missing(StrEnum):
    """How pixels count whose prediction is not finite or not positive.

    `COUNTED`: as depth 0, which is what every format here writes for "no measurement": the error
    is the whole true depth, the relative error 1, and no threshold is passed.
    `LEFT_OUT`: not at all; compare it together with coverage, since it favours methods that predict
    few pixels.
    `AS_GIVEN`: with the given number, as in released evaluations: a negative prediction then passes
    every threshold, since its ratio is below all of them.
    """

    COUNTED = "counted"
    LEFT_OUT = "left-out"
    AS_GIVEN = "as-given"


def check_reportable(missing: Missing) -> None:
    """Refuse what cannot be the main figure of a report.

    Args:
        missing: how pixels without a usable prediction are to count.

    Raises:
        ToolkitError: `LEFT_OUT`: such figures stand beside the main ones, as `..._answered`.

    >>> check_reportable(Missing.COUNTED)
    """
    if missing is Missing.LEFT_OUT:
        raise ToolkitError(
            "is no way to count pixels in a report",
            field="missing",
            value=missing.value,
            hint="the figures over answered pixels are always there, as ..._answered",
        )


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
        counts: (cells, 2, 4) pixels, and how many of them pass each of `THRESHOLDS`.
        sums: (cells, 2, 3) sums of squared, relative and absolute error.
    """

    counts: NDArray[np.int64]
    sums: NDArray[np.float64]

    def __add__(self, other: Tally) -> Tally:
        return Tally(self.counts + other.counts, self.sums + other.sums)

    def of(self, cells: NDArray[np.integer] | slice) -> Errors:
        """Errors over the union of some cells.

        Args:
            cells: indices of cells.

        Returns:
            The errors; those of missing pixels as they were counted.
        """
        members = np.zeros((1, len(self.counts)), np.bool_)
        members[0, cells] = True
        return self.of_each(members)[0]

    def of_each(self, members: NDArray[np.bool_]) -> list[Errors]:
        """Errors over several unions of cells.

        Args:
            members: (M, cells) which cells belong to which union.

        Returns:
            The errors of each of the M unions.
        """
        found = np.flatnonzero(self.counts.any(axis=(1, 2)))
        counts, sums = self.counts[found].astype(np.float64), self.sums[found]
        table = np.concatenate([counts.reshape(-1, 8), sums.reshape(-1, 6)], axis=1)
        chosen = members[:, found]
        if np.isfinite(table).all():
            totals = chosen @ table
        else:  # 0 times the NaN of a cell that does not belong would be NaN
            totals = np.stack([table[row].sum(axis=0) for row in chosen])
        by_answer = totals[:, :8].reshape(-1, 2, 4), totals[:, 8:].reshape(-1, 2, 3)
        n, means = _means(*(part.sum(axis=1) for part in by_answer))
        n_answered, means_answered = _means(*(part[:, 1] for part in by_answer))
        with np.errstate(invalid="ignore"):
            coverage = (n_answered / n)[:, None]
        figures = np.concatenate([means, coverage, means_answered], axis=1).tolist()
        return [
            Errors(int(all_of_it), int(answered), *row)
            for all_of_it, answered, row in zip(n, n_answered, figures, strict=True)
        ]


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
    counts, sums = np.zeros((2, 4, n_cells)), np.zeros((2, 3, n_cells))
    for begin in range(0, len(pred), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        p, g, c = as_real(pred[part]), as_real(true[part]), cell[part]
        usable = (p > 0) & (p < np.inf)
        for answered, at in enumerate((~usable, usable)):
            some, true_of, cell_of = p, g, c
            if not at.all():
                picked = np.flatnonzero(at)  # three takes cost less than three masks
                some, true_of, cell_of = p.take(picked), g.take(picked), c.take(picked)
            if not len(some):
                continue
            if not answered and missing is Missing.COUNTED:
                some = np.zeros_like(some)
            _add(some, true_of, cell_of, counts[answered], sums[answered])
    return Tally(np.moveaxis(counts.astype(np.int64), -1, 0), np.moveaxis(sums, -1, 0))


def _add(
    p: NDArray[np.floating],
    g: NDArray[np.floating],
    cell: NDArray[np.integer],
    counts: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> None:
    """Add pixels to (4, cells) counts and (3, cells) sums."""
    # Pixels of one cell come in runs, row by row: summing runs, and the few runs by cell, takes a
    # quarter of the time of np.bincount over all pixels.
    starts = np.concatenate([[0], np.flatnonzero(cell[1:] != cell[:-1]) + 1])
    of_run = cell[starts].astype(np.intp)
    n_cells = counts.shape[1]
    counts[0] += np.bincount(of_run, np.diff(starts, append=len(cell)), n_cells)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        worst = p / g
        np.maximum(worst, g / p, out=worst)
        for i, limit in enumerate(THRESHOLDS):
            passed = (worst < limit).view(np.uint8)
            runs = np.add.reduceat(passed, starts, dtype=np.int64)
            counts[i + 1] += np.bincount(of_run, runs, n_cells)
        error = np.subtract(p, g, dtype=np.float64)
        np.abs(error, out=error)
        for i, figure in enumerate((np.square(error), error / g, error)):
            sums[i] += np.bincount(of_run, np.add.reduceat(figure, starts), n_cells)


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


def _means(
    counts: NDArray[np.float64], sums: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels (M,), and their RMSE, REL, MAE and the three deltas (M, 6).

    From (M, 4) counts and (M, 3) sums as `Tally` has them.
    """
    n = counts[:, 0]
    with np.errstate(invalid="ignore"):
        means = np.concatenate([sums, counts[:, 1:]], axis=1) / n[:, None]
    means[:, 0] = np.sqrt(means[:, 0])
    return n, means
