"""Symmetric variants: the nearest of the poses that look the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from std_toolkit.geometry import SE3, Symmetry, mssd
from std_toolkit.geometry.symmetry import common_symmetry, fixed_point, nearest_variant

HALF_TURN_Z = (-1.0, 0, 0, 0, 0, -1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0)
HALF_TURN_X = (1.0, 0, 0, 0, 0, -1.0, 0, 0, 0, 0, -1.0, 0, 0, 0, 0, 1.0)
ABOUT_Z = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
# A ring of points that turns about z map onto the same circles.
ANGLES = np.linspace(0, 2 * np.pi, 180, endpoint=False)
CYLINDER = np.concatenate(
    [
        np.stack([0.03 * np.cos(ANGLES), 0.03 * np.sin(ANGLES), np.full_like(ANGLES, z)], axis=1)
        for z in (-0.05, 0.05)
    ]
)
SYMMETRIES = {
    "none": Symmetry(),
    "half turn": Symmetry(discrete=(HALF_TURN_Z,)),
    "axis": Symmetry(continuous=(ABOUT_Z,)),
    "axis and flip": Symmetry(discrete=(HALF_TURN_X,), continuous=(ABOUT_Z,)),
    "off-centre axis": Symmetry(continuous=(((0.0, 1.0, 0.0), (0.02, 0.0, -0.01)),)),
    "sphere": Symmetry(continuous=(ABOUT_Z, ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)))),
}
twists = st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(
    lambda x: np.array(x) * [0.1, 0.1, 0.1, 3, 3, 3]
)


@pytest.mark.parametrize("name", SYMMETRIES)
@given(twists, st.floats(-3, 3), st.integers(0, 1))
@settings(max_examples=30, deadline=None)
def test_a_symmetric_variant_comes_back_to_the_reference(
    name: str, xi: np.ndarray, angle: float, flip: int
) -> None:
    symmetry = SYMMETRIES[name]
    reference = SE3.exp(xi)
    S = symmetry.discrete_transforms()[flip % len(symmetry.discrete_transforms())]
    for index in range(len(symmetry.continuous)):
        S = S @ symmetry.turn(index, angle)
    found = nearest_variant(reference @ S, reference, CYLINDER, symmetry)
    assert np.abs(found @ CYLINDER - reference @ CYLINDER).max() < 1e-9


@pytest.mark.parametrize("name", SYMMETRIES)
@given(twists, twists)
@settings(max_examples=20, deadline=None)
def test_no_sampled_variant_lies_nearer(name: str, xi: np.ndarray, eta: np.ndarray) -> None:
    symmetry, T, reference = SYMMETRIES[name], SE3.exp(xi), SE3.exp(eta)
    target = reference @ CYLINDER
    best = np.linalg.norm(nearest_variant(T, reference, CYLINDER, symmetry) @ CYLINDER - target)
    sampled = min(np.linalg.norm(T @ S @ CYLINDER - target) for S in symmetry.transforms(steps=90))
    assert best <= sampled + 1e-9


@pytest.mark.parametrize("name", SYMMETRIES)
def test_the_fixed_point_stays_under_all_symmetries(name: str) -> None:
    symmetry = SYMMETRIES[name]
    point = fixed_point(symmetry, np.array([0.01, 0.002, 0.003]))
    for S in symmetry.transforms(steps=7):
        np.testing.assert_allclose(S @ point, point, atol=1e-12)


def test_the_fixed_point_of_no_symmetry_is_the_point() -> None:
    np.testing.assert_array_equal(fixed_point(Symmetry(), np.array([1.0, 2.0, 3.0])), [1, 2, 3])


def test_common_symmetries_are_those_that_both_hold() -> None:
    axis, half = SYMMETRIES["axis"], SYMMETRIES["half turn"]
    assert common_symmetry(axis, Symmetry(), CYLINDER).is_trivial
    assert common_symmetry(axis, axis, CYLINDER) == axis
    # A half turn about z is one of the turns about z.
    assert common_symmetry(axis, half, CYLINDER) == half
    assert common_symmetry(half, axis, CYLINDER) == half
    assert common_symmetry(SYMMETRIES["axis and flip"], axis, CYLINDER) == axis
    assert common_symmetry(SYMMETRIES["sphere"], axis, CYLINDER) == axis
    flip = Symmetry(discrete=(HALF_TURN_X,))
    assert common_symmetry(half, flip, CYLINDER).is_trivial


def test_poses_that_differ_by_a_common_symmetry_have_no_distance() -> None:
    common = common_symmetry(SYMMETRIES["axis and flip"], SYMMETRIES["axis"], CYLINDER)
    turned = common.turn(0, 1.234)
    assert mssd(turned, SE3.identity(), CYLINDER, common) < 1e-6
