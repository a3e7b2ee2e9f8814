"""Colorization: depth spreads from measured pixels to pixels of similar brightness.

Solves sparse linear systems that couple neighbouring pixels, exactly.
"""

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from benchmark.methods.depth.filling.filler import Filler
from std_toolkit.geometry.camera import Camera

LEAF = 8  # side of the blocks that are not cut further

Solve = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# In multiples of the variance of brightness around a pixel: what the NYU Depth V2 tools use.
VARIANCE_FACTOR = 0.6

# The likest neighbour weighs at least this, relative to one of equal brightness.
LEAST_WEIGHT = 0.01

LEAST_VARIANCE = 2e-6  # brightness in 0 to 1; below it a picture is flat


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


AROUND = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]


class Colorization(Filler):
    """Every missing pixel is the mean of its eight neighbours, weighted by likeness of brightness.

    A linear system over the missing pixels; the measured ones are its boundary values and stay as
    they are. Its solution lies between the smallest and the largest measured depth.

    Levin, Lischinski, Weiss: Colorization using optimization. ACM Transactions on Graphics 23(3),
    2004; with the weights of the tools of NYU Depth V2 (Silberman et al., ECCV 2012).
    """

    name = "colorization"

    def fill(
        self,
        color: NDArray[np.uint8],
        depth: NDArray[np.float64],
        missing: NDArray[np.bool_],
        camera: Camera,  # noqa: ARG002
    ) -> NDArray[np.floating]:
        return spread_depth(color, depth, missing)


def spread_depth(
    color: NDArray[np.uint8], depth: NDArray[np.float64], missing: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(h, w) depth whose missing pixels follow from the others by colorization.

    Args:
        color: (h, w, 3) uint8 RGB.
        depth: (h, w) metres.
        missing: (h, w) bool; at least one pixel is missing, and one is not.
    """
    matrix, right = colorization_system(color, depth, missing)
    solution = factorized(matrix, missing)(right)
    filled = np.array(depth, dtype=np.float64)
    # Rounding apart the solution is in this range already.
    filled[missing] = np.clip(solution, depth[~missing].min(), depth[~missing].max())
    return filled


def colorization_system(
    color: NDArray[np.uint8], depth: NDArray[np.float64], missing: NDArray[np.bool_]
) -> tuple[csc_matrix, NDArray[np.float64]]:
    """Matrix (n, n) and right side (n,) of the depth of the n missing pixels, row by row."""
    rows, columns = np.nonzero(missing)
    count = len(rows)
    weights = _weights(color, rows, columns)
    number = np.full((missing.shape[0] + 2, missing.shape[1] + 2), -1)
    number[rows + 1, columns + 1] = np.arange(count)
    known = np.pad(np.where(missing, 0.0, depth), 1)
    own = np.arange(count)
    at_rows, at_columns, entries = [own], [own], [np.ones(count)]
    right = np.zeros(count)
    for (dy, dx), weight in zip(AROUND, weights, strict=True):
        neighbour = number[rows + 1 + dy, columns + 1 + dx]
        unknown = neighbour >= 0
        at_rows.append(own[unknown])
        at_columns.append(neighbour[unknown])
        entries.append(-weight[unknown])
        right += np.where(unknown, 0.0, weight * known[rows + 1 + dy, columns + 1 + dx])
    matrix = csc_matrix(
        (np.concatenate(entries), (np.concatenate(at_rows), np.concatenate(at_columns))),
        shape=(count, count),
    )
    return matrix, right


def _weights(
    color: NDArray[np.uint8], rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.float64]:
    """(8, n) weights of the neighbours of n pixels; they sum to 1, and are 0 off the image."""
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float64) / 255
    framed = np.pad(grey, 1)
    inside = np.pad(np.ones(grey.shape, dtype=bool), 1)
    there = np.stack([inside[rows + 1 + dy, columns + 1 + dx] for dy, dx in AROUND])
    values = np.stack([framed[rows + 1 + dy, columns + 1 + dx] for dy, dx in AROUND])
    center = grey[rows, columns]
    unlike = np.where(there, values - center, 0.0)  # relative to the centre: exact where flat
    amount = there.sum(axis=0) + 1
    mean = unlike.sum(axis=0) / amount
    variance = (unlike**2).sum(axis=0) / amount - mean**2
    unlike2 = unlike**2
    likest = np.where(there, unlike2, np.inf).min(axis=0)
    spread = np.maximum(VARIANCE_FACTOR * variance, likest / -np.log(LEAST_WEIGHT))
    weights = np.where(there, np.exp(-unlike2 / np.maximum(spread, LEAST_VARIANCE)), 0.0)
    return np.asarray(weights / weights.sum(axis=0))
