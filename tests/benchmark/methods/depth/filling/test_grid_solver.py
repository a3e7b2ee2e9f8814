"""Systems over pixels are solved exactly, whatever the image's size and its missing pixels."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.methods.depth.filling.colorization import (
    _dissection,
    colorization_system,
    factorized,
)


@pytest.mark.parametrize("size", [(1, 1), (1, 50), (50, 1), (8, 8), (9, 9), (17, 31), (40, 23)])
def test_every_pixel_is_eliminated_once(size: tuple[int, int]) -> None:
    assert sorted(_dissection(*size)) == list(range(size[0] * size[1]))


@pytest.mark.parametrize("size", [(1, 30), (9, 9), (19, 26)])
@pytest.mark.parametrize("share", [0.3, 0.95])
def test_the_solution_is_that_of_a_dense_solver(size: tuple[int, int], share: float) -> None:
    rng = np.random.default_rng(1)
    missing = rng.uniform(size=size) < share
    missing[0, 0], missing[-1, -1] = False, True
    color = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
    matrix, right = colorization_system(color, rng.uniform(0.5, 1, size), missing)
    expected = np.linalg.solve(matrix.toarray(), right)
    solve = factorized(matrix, missing)
    assert np.allclose(solve(right), expected, rtol=1e-10)
    assert np.allclose(solve(2 * right), 2 * expected, rtol=1e-10)  # and can be used again


def test_cuts_separate_the_image() -> None:
    # The last to be eliminated is the longest line through the middle.
    order = _dissection(20, 31)
    assert set(order[-20:]) == {row * 31 + 15 for row in range(20)}
