"""Counts and sums of depth errors by cell.

A cell is any class of pixels (an object, an object's edge). The errors of every union of cells are
computed from the sums without access to the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.depth.figures import (
    FIGURES,
    Errors,
    Missing,
    Pixels,
    as_real,
    check_reportable,
    usable,
)

_AT_ONCE = 1 << 15  # pixels whose intermediate figures stay in the processor's cache

# The tally has the figures that are means of numbers first, then the shares of pixels.
_MEANS = tuple(figure for figure in FIGURES if not figure.is_share)
_SHARES = tuple(figure for figure in FIGURES if figure.is_share)
_COUNTS = 1 + len(_SHARES)
_ORDER = [(*_MEANS, *_SHARES).index(figure) for figure in FIGURES]
_ROOTS = [place for place, figure in enumerate(FIGURES) if figure.is_root]


@dataclass(frozen=True)
class Tally:
    """Counts and sums by cell (first axis) and by whether the prediction is usable (second).

    Attributes:
        counts: (cells, 2, 1 + S) pixels, and how many of them are in each of the S shares.
        sums: (cells, 2, M) sums of the M other figures.
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
        by_cell = counts.reshape(-1, 2 * _COUNTS), sums.reshape(-1, 2 * len(_MEANS))
        table = np.concatenate(by_cell, axis=1)
        chosen = members[:, found]
        if np.isfinite(table).all():
            totals = chosen @ table
        else:  # 0 times the NaN of a cell that does not belong would be NaN
            totals = np.stack([table[row].sum(axis=0) for row in chosen])
        by_answer = (
            totals[:, : 2 * _COUNTS].reshape(-1, 2, _COUNTS),
            totals[:, 2 * _COUNTS :].reshape(-1, 2, len(_MEANS)),
        )
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
    counts = np.zeros((2, _COUNTS, n_cells))
    sums = np.zeros((2, len(_MEANS), n_cells))
    for begin in range(0, len(pred), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        p, g, c = as_real(pred[part]), as_real(true[part]), cell[part]
        is_answered = usable(p)
        for answered, at in enumerate((~is_answered, is_answered)):
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
    """Add pixels to (1 + S, cells) counts and (M, cells) sums."""
    # Pixels of one cell come in runs, row by row: summing runs, and the few runs by cell, takes a
    # quarter of the time of np.bincount over all pixels.
    starts = np.concatenate([[0], np.flatnonzero(cell[1:] != cell[:-1]) + 1])
    of_run = cell[starts].astype(np.intp)
    n_cells = counts.shape[1]
    counts[0] += np.bincount(of_run, np.diff(starts, append=len(cell)), n_cells)
    pixels = Pixels(p, g)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        for i, figure in enumerate(_SHARES):
            runs = np.add.reduceat(figure.of(pixels).view(np.uint8), starts, dtype=np.int64)
            counts[i + 1] += np.bincount(of_run, runs, n_cells)
        for i, figure in enumerate(_MEANS):
            sums[i] += np.bincount(of_run, np.add.reduceat(figure.of(pixels), starts), n_cells)


def _means(
    counts: NDArray[np.float64], sums: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels (M,), and their figures (M, F), from counts and sums as `Tally` has them."""
    n = counts[:, 0]
    with np.errstate(invalid="ignore"):
        means = np.concatenate([sums, counts[:, 1:]], axis=1)[:, _ORDER] / n[:, None]
    means[:, _ROOTS] = np.sqrt(means[:, _ROOTS])
    return n, means
