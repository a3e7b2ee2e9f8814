"""Exact solution of sparse linear systems whose unknowns are pixels coupled to their neighbours."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

LEAF = 8  # side of the blocks that are not cut further
Solve = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def factorized(matrix: csc_matrix, unknown: NDArray[np.bool_]) -> Solve:
    """A function that solves the system for a right side.

    The unknowns are eliminated in the order of a nested dissection of the image: a row or column
    cuts it in two halves that know nothing of each other and comes last, and so on inside the
    halves (George: Nested dissection of a regular finite element mesh, 1973). That fills in least
    on a grid; `perf/bench_filling.py` compares it with the orderings of SuperLU.

    Args:
        matrix: (n, n) with a symmetric pattern that couples a pixel to its eight neighbours at
            most, and diagonally dominant or positive definite: it is not pivoted.
        unknown: (h, w) bool; its n true pixels, row by row, are the unknowns.
    """
    number = np.full(unknown.size, -1)
    number[np.flatnonzero(unknown)] = np.arange(matrix.shape[0])
    order = number[_dissection(*unknown.shape)]
    order = order[order >= 0]
    factors = splu(
        matrix[order][:, order].tocsc(),
        permc_spec="NATURAL",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )

    def solve(right: NDArray[np.float64]) -> NDArray[np.float64]:
        solution = np.empty_like(right)
        solution[order] = factors.solve(right[order])
        return solution

    return solve


@lru_cache(maxsize=4)
def _dissection(height: int, width: int) -> NDArray[np.intp]:
    """(height * width,) flat pixels in the order of their elimination."""
    pixels = np.arange(height * width).reshape(height, width)
    parts: list[NDArray[np.intp]] = []

    def cut(block: NDArray[np.intp]) -> None:
        rows, columns = block.shape
        if max(rows, columns) <= LEAF:
            parts.append(block.ravel())
        elif rows >= columns:
            cut(block[: rows // 2])
            cut(block[rows // 2 + 1 :])
            parts.append(block[rows // 2])
        else:
            cut(block[:, : columns // 2])
            cut(block[:, columns // 2 + 1 :])
            parts.append(block[:, columns // 2])

    cut(pixels)
    order = np.concatenate(parts)
    order.flags.writeable = False
    return order
