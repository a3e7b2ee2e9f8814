"""Rigid transforms are a group, and their logarithm and quaternion are exact everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_angle, so3_exp, so3_log
from std_toolkit.geometry.se3 import nearest_rotation, skew

coordinates = st.floats(-10, 10, allow_nan=False)
vectors = st.tuples(coordinates, coordinates, coordinates).map(np.array)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
# Angles where formulas break: next to 0, and next to half a turn.
angles = st.one_of(
    st.floats(0, np.pi),
    st.floats(-16, -1).map(lambda e: 10.0**e),
    st.floats(-15, -1).map(lambda e: np.pi - 10.0**e),
    st.sampled_from([0.0, np.pi / 2, np.pi]),
)
rotation_vectors = st.builds(lambda d, a: d * a, directions, angles)
poses = st.builds(lambda rho, phi: SE3.exp([*rho, *phi]), vectors, rotation_vectors)


def assert_same(a: SE3, b: SE3, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(a.matrix(), b.matrix(), atol=tolerance)


@given(poses, poses, poses)
def test_composition_is_associative(a: SE3, b: SE3, c: SE3) -> None:
    assert_same((a @ b) @ c, a @ (b @ c))


@given(poses)
def test_identity_is_neutral_and_the_inverse_undoes(T: SE3) -> None:
    assert_same(T @ SE3.identity(), T)
    assert_same(SE3.identity() @ T, T)
    assert_same(T @ T.inverse(), SE3.identity())
    assert_same(T.inverse() @ T, SE3.identity())


@given(poses, poses, vectors)
def test_composition_transforms_points_from_right_to_left(a: SE3, b: SE3, p: np.ndarray) -> None:
    np.testing.assert_allclose((a @ b) @ p, a @ (b @ p), atol=1e-11)


@given(poses, vectors)
def test_points_transform_as_by_the_matrix(T: SE3, p: np.ndarray) -> None:
    np.testing.assert_allclose(T @ p, (T.matrix() @ [*p, 1])[:3], atol=1e-11)
    cloud = np.tile(p, (2, 4, 1))
    np.testing.assert_allclose(T @ cloud, np.tile(T @ p, (2, 4, 1)), atol=1e-11)


@given(poses)
def test_results_stay_rotations(T: SE3) -> None:
    np.testing.assert_allclose(T.R @ T.R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(T.R) == pytest.approx(1, abs=1e-13)


@given(vectors, rotation_vectors)
def test_log_inverts_exp(rho: np.ndarray, phi: np.ndarray) -> None:
    T = SE3.exp([*rho, *phi])
    np.testing.assert_allclose(SE3.exp(T.log()).matrix(), T.matrix(), atol=1e-12)
    # At half a turn, phi and -phi are the same rotation.
    if np.linalg.norm(phi) < np.pi - 1e-6:
        np.testing.assert_allclose(T.log(), [*rho, *phi], atol=1e-11)


@given(rotation_vectors)
def test_rotation_angle_is_exact_near_zero_and_half_a_turn(phi: np.ndarray) -> None:
    angle = np.linalg.norm(phi)
    assert rotation_angle(so3_exp(phi)) == pytest.approx(angle, rel=1e-12, abs=1e-15)


def test_a_tiny_rotation_is_not_lost() -> None:
    phi = np.array([3e-9, -4e-9, 0])
    np.testing.assert_allclose(so3_log(so3_exp(phi)), phi, rtol=1e-12)
    np.testing.assert_allclose(SE3.exp([1, 2, 3, *phi]).log()[:3], [1, 2, 3], rtol=1e-15)


def test_exp_moves_along_a_screw() -> None:
    """A quarter turn about z while moving along x ends on a quarter circle of radius 2/pi."""
    T = SE3.exp([1, 0, 0, 0, 0, np.pi / 2])
    np.testing.assert_allclose(T.t, [2 / np.pi, 2 / np.pi, 0], atol=1e-15)
    np.testing.assert_allclose(T.R @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@given(poses)
def test_quaternion_round_trip(T: SE3) -> None:
    q = T.quat()
    assert q[0] >= 0
    assert np.linalg.norm(q) == pytest.approx(1, abs=1e-15)
    assert_same(SE3.from_quat(q, T.t), T, 1e-14)
    assert_same(SE3.from_quat(-q, T.t), T, 1e-14)


def test_quaternions_are_wxyz() -> None:
    quarter_about_z = SE3.from_quat([np.sqrt(0.5), 0, 0, np.sqrt(0.5)], [0, 0, 0])
    np.testing.assert_allclose(quarter_about_z.R @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@given(poses)
def test_the_flat_list_is_row_major_and_round_trips_bit_exactly(T: SE3) -> None:
    numbers = T.flat()
    assert numbers[3] == T.t[0]
    again = SE3.from_matrix(numbers)
    assert_same(SE3.from_matrix(T.matrix()[:3]), T, 1e-14)
    np.testing.assert_array_equal(SE3.from_matrix(again.flat()).matrix(), again.matrix())


@given(poses)
def test_printed_digits_are_mended(T: SE3) -> None:
    read = SE3.from_matrix(np.round(T.matrix(), 5))
    np.testing.assert_allclose(read.R @ read.R.T, np.eye(3), atol=1e-14)
    assert rotation_angle(read.R.T @ T.R) < 3e-5


FLIP = np.diag([1.0, 1, -1, 1])
WRONG_POSES = {
    "mirrored": FLIP,
    "scaled": np.diag([2.0, 2, 2, 1]),
    "slightly_scaled": np.diag([1.001, 1.001, 1.001, 1]),
    "sheared": np.eye(4) + np.eye(4, k=1),
    "zero": np.zeros((4, 4)),
    "transposed": SE3.exp([1, 2, 3, 0.1, 0.2, 0.3]).matrix().T,
    "not_a_number": np.full((4, 4), np.nan),
    "rotation_not_a_number": np.where(np.eye(4) == 1, np.nan, 0.0),
    "infinite": np.eye(4) + [[0, 0, 0, np.inf]] * 4,
    "nine_numbers": np.eye(3),
    "column_of_rows": np.eye(4).reshape(2, 8),
    "columns_first": np.ones((4, 3)),
    "words": [["a"] * 4] * 4,
    "ragged": [[1, 0], [0]],
}


@pytest.mark.parametrize("T", WRONG_POSES.values(), ids=WRONG_POSES.keys())
def test_what_is_no_pose_is_refused(T: object) -> None:
    with pytest.raises(ToolkitError):
        SE3.from_matrix(T)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("q", "t"),
    [
        ([0, 0, 0, 0], [0, 0, 0]),
        ([2, 0, 0, 0], [0, 0, 0]),
        ([np.nan, 0, 0, 1], [0, 0, 0]),
        ([1, 0, 0], [0, 0, 0]),
        ([1, 0, 0, 0], [0, np.inf, 0]),
        ([1, 0, 0, 0], [0, 0]),
    ],
)
def test_what_is_no_quaternion_pose_is_refused(q: list[float], t: list[float]) -> None:
    with pytest.raises(ToolkitError):
        SE3.from_quat(q, t)


def test_wrong_shapes_are_refused_and_float32_is_widened() -> None:
    with pytest.raises(ToolkitError, match="3x3"):
        SE3(np.eye(4), np.zeros(3))
    with pytest.raises(ToolkitError, match="3x3"):
        nearest_rotation(np.eye(2))
    assert SE3(np.eye(3, dtype=np.float32), np.zeros(3, dtype=np.float32)).R.dtype == np.float64


def test_a_pose_does_not_change_with_the_numbers_it_came_from() -> None:
    state = np.array([1.0, 0, 0, 0, 0.1, 0.2, 0.3])
    T = SE3.from_quat(state[:4], state[4:])
    state[:] = 7
    np.testing.assert_array_equal(T.t, [0.1, 0.2, 0.3])


@pytest.mark.parametrize("angle", [1e-9, 1e-5, 9e-4, 1.1e-3, 0.5])
def test_the_translation_of_a_small_twist_is_the_sum_of_its_series(angle: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3
    S = skew(angle * axis)
    expected, term = np.eye(3), np.eye(3)
    for n in range(2, 20):
        term = term @ S / n
        expected = expected + term
    T = SE3.exp(np.concatenate([[1.0, -2.0, 3.0], angle * axis]))
    assert np.abs(T.t - expected @ [1.0, -2.0, 3.0]).max() < 3e-15


def test_a_quaternion_of_about_unit_length_gives_a_rotation() -> None:
    q = SE3.exp([0, 0, 0, 0.4, -0.3, 1.0]).quat()
    T = SE3.from_quat(1.005 * q, [0, 0, 0])
    assert np.abs(T.R @ T.R.T - np.eye(3)).max() < 1e-14
    assert_same(T, SE3.from_quat(q, [0, 0, 0]), 1e-14)


@pytest.mark.parametrize("t", [[0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
def test_a_translation_has_three_numbers(t: list[float]) -> None:
    with pytest.raises(ToolkitError):
        SE3.from_quat([1.0, 0.0, 0.0, 0.0], t)


@given(poses, vectors, rotation_vectors)
def test_the_adjoint_moves_a_perturbation_to_the_left(
    T: SE3, rho: np.ndarray, phi: np.ndarray
) -> None:
    xi = 1e-3 * np.concatenate([rho, phi])
    assert_same(T @ SE3.exp(xi), SE3.exp(T.adjoint() @ xi) @ T, 1e-9)
