"""The mean pose of several annotators."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from two_annotators import MESHES, SYMMETRIES, TRUE_POSES

from annotator.compare import mean_pose
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Symmetry, mssd, so3_exp

POINTS = np.asarray(MESHES["wedge"].vertices)
twists = st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(
    lambda x: np.array(x) * [0.05, 0.05, 0.05, 0.5, 0.5, 0.5]
)


def same(a: SE3, b: SE3, tolerance: float = 1e-12) -> bool:
    return bool(np.abs(a.matrix() - b.matrix()).max() < tolerance)


def test_the_mean_of_equal_poses_is_that_pose_bit_for_bit() -> None:
    T = TRUE_POSES["wedge"]
    mean = mean_pose([T, T, T], POINTS, Symmetry()).pose
    assert (mean.matrix() == T.matrix()).all()


def test_the_mean_of_two_lies_half_way() -> None:
    a = SE3(so3_exp([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 0.70]))
    b = SE3(so3_exp([0.0, 0.0, 0.3]), np.array([0.0, 0.0, 0.72]))
    mean = mean_pose([a, b], POINTS, Symmetry()).pose
    assert same(mean, SE3(so3_exp([0.0, 0.0, 0.2]), np.array([0.0, 0.0, 0.71])))


@given(twists, twists)
@settings(max_examples=50, deadline=None)
def test_the_mean_of_two_is_as_far_from_both_and_does_not_depend_on_their_order(
    xi: np.ndarray, eta: np.ndarray
) -> None:
    a, b = TRUE_POSES["wedge"] @ SE3.exp(xi), TRUE_POSES["wedge"] @ SE3.exp(eta)
    mean = mean_pose([a, b], POINTS, Symmetry()).pose
    there, back = (mean.inverse() @ a).log(), (mean.inverse() @ b).log()
    np.testing.assert_allclose(there, -back, atol=1e-11)
    assert same(mean, mean_pose([b, a], POINTS, Symmetry()).pose, 1e-11)


@given(twists, twists, twists)
@settings(max_examples=30, deadline=None)
def test_the_mean_does_not_depend_on_where_the_mesh_has_its_origin(
    xi: np.ndarray, eta: np.ndarray, zeta: np.ndarray
) -> None:
    poses = [TRUE_POSES["wedge"] @ SE3.exp(x) for x in (xi, eta, zeta)]
    T_old_new = SE3.exp([0.3, -0.2, 0.5, 1.0, 0.2, -0.7])
    moved_points = T_old_new.inverse() @ POINTS
    moved = mean_pose([T @ T_old_new for T in poses], moved_points, Symmetry()).pose
    assert same(moved, mean_pose(poses, POINTS, Symmetry()).pose @ T_old_new, 1e-10)


@pytest.mark.parametrize("name", ["can", "tile"])
@given(twists, st.floats(-3, 3))
@settings(max_examples=20, deadline=None)
def test_symmetric_variants_are_brought_together_first(
    name: str, xi: np.ndarray, angle: float
) -> None:
    symmetry = SYMMETRIES[name].symmetry()
    points = np.asarray(MESHES[name].vertices)
    a = TRUE_POSES[name]
    b = a @ SE3.exp(xi / 10)
    S = symmetry.turn(0, angle) if symmetry.continuous else symmetry.discrete_transforms()[1]
    plain = mean_pose([a, b], points, symmetry).pose
    turned = mean_pose([a, b @ S], points, symmetry).pose
    # The vertices of the mesh are a polygon's: a turn in between is as good as its corners are.
    assert mssd(turned, plain, points, symmetry) < 2e-5


def test_covariances_are_the_weights() -> None:
    a = TRUE_POSES["wedge"]
    b = a @ SE3.exp([0.010, 0.0, 0.0, 0.0, 0.0, 0.0])
    sure, unsure = np.eye(6) * 1e-6, np.eye(6) * 9e-6
    mean = mean_pose([a, b], POINTS, Symmetry(), [sure, unsure])
    assert same(mean.pose, a @ SE3.exp([0.001, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert mean.covariance is not None
    # Of two that may have erred together, the information is averaged, not added.
    expected = np.eye(6) * 2 / (1 / 1e-6 + 1 / 9e-6)
    np.testing.assert_allclose(mean.covariance, expected, atol=1e-15)


def test_what_one_does_not_know_along_its_ray_the_other_decides() -> None:
    a = TRUE_POSES["wedge"]
    b = a @ SE3.exp([0.010, 0.004, 0.0, 0.0, 0.0, 0.0])
    weak_x, weak_y = np.eye(6) * 1e-6, np.eye(6) * 1e-6
    weak_x[0, 0] = weak_y[1, 1] = 1.0
    mean = mean_pose([a, b], POINTS, Symmetry(), [weak_x, weak_y]).pose
    assert same(mean, a @ SE3.exp([0.010, 0.0, 0.0, 0.0, 0.0, 0.0]), 1e-7)


def test_a_covariance_goes_along_with_the_symmetric_variant() -> None:
    # The tile of b is turned by half about z, so its own x points against that of a.
    a = TRUE_POSES["tile"]
    symmetry = SYMMETRIES["tile"].symmetry()
    b = a @ symmetry.discrete_transforms()[1]
    covariance = np.diag([1.0, 2, 3, 4, 5, 6]) * 1e-6
    covariance[0, 2] = covariance[2, 0] = 0.5e-6
    mean = mean_pose([a, b], np.asarray(MESHES["tile"].vertices), symmetry, [covariance] * 2)
    assert same(mean.pose, a)
    mirrored = covariance.copy()
    mirrored[0, 2] = mirrored[2, 0] = -0.5e-6
    expected = 2 * np.linalg.inv(np.linalg.inv(covariance) + np.linalg.inv(mirrored))
    assert mean.covariance is not None
    np.testing.assert_allclose(mean.covariance, expected, rtol=1e-6, atol=1e-14)


@pytest.mark.parametrize("other", [None, np.zeros((6, 6)), -np.eye(6)])
def test_without_all_covariances_all_count_the_same(other: np.ndarray | None) -> None:
    a = TRUE_POSES["wedge"]
    b = a @ SE3.exp([0.010, 0.0, 0.0, 0.0, 0.0, 0.0])
    mean = mean_pose([a, b], POINTS, Symmetry(), [np.eye(6), other])
    assert same(mean.pose, a @ SE3.exp([0.005, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert mean.covariance is None


def test_no_poses_have_no_mean() -> None:
    with pytest.raises(ToolkitError, match="no poses"):
        mean_pose([], POINTS, Symmetry())
