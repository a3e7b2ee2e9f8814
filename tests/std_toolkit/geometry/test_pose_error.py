"""Pose errors: over all symmetries, exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import (
    SE3,
    Symmetry,
    mssd,
    rotation_error,
    so3_exp,
    translation_error,
)

numbers = st.floats(-1, 1)
poses = st.tuples(*[numbers] * 6).map(SE3.exp)
CUBE = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * 0.05
HALF_TURN_Z = (-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
BOTTLE = Symmetry(continuous=(((0.0, 0.0, 1.0), (0.01, 0.02, 0.0)),))
BALL = Symmetry(
    continuous=(((0.0, 0.0, 1.0), (0.01, 0.0, 0.0)), ((1.0, 0.0, 0.0), (0.01, 0.0, 0.0)))
)


def ring(count: int = 40) -> np.ndarray:
    """Vertices of a bottle about the axis of BOTTLE."""
    a = np.linspace(0, 2 * np.pi, count, endpoint=False)
    circle = np.stack([0.03 * np.cos(a) + 0.01, 0.03 * np.sin(a) + 0.02], axis=1)
    return np.vstack([np.c_[circle, np.full(count, z)] for z in (0.0, 0.2)])


@given(poses)
def test_equal_poses_have_no_error(T: SE3) -> None:
    assert mssd(T, T, CUBE) < 1e-15
    assert rotation_error(T, T) < 1e-15
    assert translation_error(T, T) == 0


def test_mssd_of_a_shift_is_its_length_and_of_a_turn_its_longest_chord() -> None:
    T = SE3.exp([0.1, 0.2, 0.7, 0.3, 0.2, 0.1])
    shifted = SE3(T.R, T.t + np.array([0.003, 0, 0.004]))
    assert mssd(shifted, T, CUBE) == pytest.approx(0.005)
    assert translation_error(shifted, T) == pytest.approx(0.005)
    turned = T @ SE3(so3_exp([0, 0, 0.1]), np.zeros(3))
    radius = 0.05 * np.sqrt(2)
    assert mssd(turned, T, CUBE) == pytest.approx(2 * radius * np.sin(0.05))
    assert rotation_error(turned, T) == pytest.approx(0.1)


@given(poses, poses, poses)
def test_mssd_does_not_depend_on_the_frame(a: SE3, b: SE3, camera: SE3) -> None:
    assert mssd(camera @ a, camera @ b, CUBE) == pytest.approx(mssd(a, b, CUBE), abs=1e-12)


@given(poses)
def test_a_discrete_symmetry_is_no_error(T: SE3) -> None:
    symmetry = Symmetry(discrete=(HALF_TURN_Z,))
    turned = T @ SE3.from_matrix(HALF_TURN_Z)
    assert mssd(turned, T, CUBE, symmetry) < 1e-12
    assert rotation_error(turned, T, symmetry) < 1e-12
    assert mssd(turned, T, CUBE) > 0.1
    assert rotation_error(turned, T) == pytest.approx(np.pi)


@settings(max_examples=25, deadline=None)
@given(poses, st.floats(-np.pi, np.pi))
def test_any_turn_about_a_continuous_axis_is_no_error(T: SE3, angle: float) -> None:
    """Also turns between the samples: sampling alone would leave up to half a step."""
    turned = T @ BOTTLE.turn(0, angle)
    assert rotation_error(turned, T, BOTTLE) < 1e-7
    assert mssd(turned, T, ring(), BOTTLE, steps=72) < 1e-6


def test_a_tilt_of_a_bottle_counts_however_it_is_turned() -> None:
    tilt = SE3.exp([0, 0, 0, 0.05, 0, 0])
    for angle in (0.0, 1.0, 2.5):
        estimate = tilt @ BOTTLE.turn(0, angle)
        assert rotation_error(estimate, SE3.identity(), BOTTLE) == pytest.approx(0.05)


@pytest.mark.slow
def test_mssd_agrees_with_dense_sampling() -> None:
    estimate = SE3.exp([0.002, 0.001, -0.003, 0.05, -0.03, 1.234])
    dense = min(
        np.linalg.norm(estimate @ ring() - BOTTLE.turn(0, a) @ ring(), axis=1).max()
        for a in np.linspace(0, 2 * np.pi, 10000)
    )
    error = mssd(estimate, SE3.identity(), ring(), BOTTLE)
    assert dense - 1e-5 < error <= dense


@settings(max_examples=25, deadline=None)
@given(poses, st.tuples(*[st.floats(-3, 3)] * 3))
def test_a_ball_has_no_rotation(T: SE3, phi: tuple) -> None:
    centre = np.array([0.01, 0, 0])
    R = so3_exp(phi)
    turned = T @ SE3(R, centre - R @ centre)
    assert rotation_error(turned, T, BALL) == 0
    assert mssd(turned, T, CUBE, BALL) < 1e-12
    shifted = SE3(turned.R, turned.t + np.array([0.004, 0.003, 0]))
    assert mssd(shifted, T, CUBE, BALL) == pytest.approx(0.005)


def test_transforms_list_the_identity_first_and_combine_discrete_with_continuous() -> None:
    flip_x = (1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1)
    can = Symmetry(discrete=(flip_x,), continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))
    transforms = can.transforms(8)
    assert len(transforms) == 16
    np.testing.assert_array_equal(transforms[0].matrix(), np.eye(4))
    upside_down = [T for T in transforms if T.R[2, 2] < 0]
    assert len(upside_down) == 8
    assert Symmetry().transforms()[0].matrix().tolist() == np.eye(4).tolist()
    assert Symmetry().is_trivial
    assert not can.is_trivial


def test_a_continuous_symmetry_turns_about_its_offset() -> None:
    for T in BOTTLE.transforms(12):
        np.testing.assert_allclose(T @ np.array([0.01, 0.02, 0.5]), [0.01, 0.02, 0.5], atol=1e-15)


@pytest.mark.parametrize(
    "wrong",
    [
        {"discrete": (tuple(np.diag([1, 1, -1, 1]).ravel()),)},
        {"discrete": ((1, 2, 3),)},
        {"continuous": (((0, 0, 2), (0, 0, 0)),)},
        {"continuous": (((0, 0, 0), (0, 0, 0)),)},
        {"continuous": (((0, 0, 1), (0, np.nan, 0)),)},
    ],
)
def test_what_is_no_symmetry_is_refused(wrong: dict) -> None:
    with pytest.raises(ToolkitError):
        Symmetry(**wrong)


@pytest.mark.parametrize("steps", [7, 360])
def test_any_turn_about_the_axis_of_symmetry_is_found(steps: int) -> None:
    T = SE3.exp([0.1, 0.2, 0.7, 0.3, 0.2, 0.1])
    for angle in np.linspace(0, 2 * np.pi, 50):
        turned = T @ BOTTLE.turn(0, float(angle))
        assert mssd(turned, T, ring(), BOTTLE, steps=steps) < 1e-6


def test_the_axis_of_a_symmetry_may_point_anywhere() -> None:
    axis = np.array([1.0, 2.0, -2.0]) / 3
    symmetry = Symmetry(continuous=((tuple(axis), (0.0, 0.0, 0.0)),))
    T = SE3.exp([0.1, 0.2, 0.7, 0.3, 0.2, 0.1])
    across = np.array([2.0, 1.0, 2.0]) / 3
    turned = T @ SE3(so3_exp(across * 0.2) @ so3_exp(axis * 1.1), np.zeros(3))
    assert rotation_error(turned, T, symmetry) == pytest.approx(0.2)
