"""Similarities: exact without noise, and unmoved by outliers, unlike the field's reference."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import (
    SE3,
    Similarity,
    ransac_similarity,
    rotation_angle,
    so3_exp,
    umeyama,
)

rotations = st.tuples(*[st.floats(-2, 2)] * 3).map(so3_exp)
translations = st.tuples(*[st.floats(-5, 5)] * 3).map(np.array)
scales = st.floats(1e-3, 1e3)
similarities = st.builds(Similarity, scales, rotations, translations)


def cloud(count: int = 50, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.1, 0.1, (count, 3)) * [1, 0.7, 0.4]


def assert_same(a: Similarity, b: Similarity) -> None:
    np.testing.assert_allclose(a.matrix(), b.matrix(), rtol=1e-9, atol=1e-9 * max(1, b.scale))


@given(similarities, st.integers(4, 60))
def test_noise_free_points_give_the_exact_similarity(truth: Similarity, count: int) -> None:
    points = cloud(count)
    assert_same(umeyama(points, truth @ points), truth)


@given(similarities)
def test_three_points_and_planar_points_are_enough(truth: Similarity) -> None:
    triangle = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]])
    assert_same(umeyama(triangle, truth @ triangle), truth)
    plane = cloud() * [1, 1, 0]
    assert_same(umeyama(plane, truth @ plane), truth)


@given(similarities)
def test_inverse_and_composition_with_points(truth: Similarity) -> None:
    points = cloud()
    np.testing.assert_allclose(truth.inverse() @ (truth @ points), points, atol=1e-9)
    homogeneous = np.c_[points, np.ones(len(points))] @ truth.matrix().T
    np.testing.assert_allclose(homogeneous[:, :3], truth @ points, atol=1e-9 * truth.scale)


def test_a_mirrored_cloud_gives_a_rotation_and_never_a_reflection() -> None:
    points = cloud()
    fit = umeyama(points, points * [1, 1, -1])
    assert np.linalg.det(fit.R) == pytest.approx(1)
    # The least-squares rotation of a cloud thinnest along z, mirrored in z, is the identity.
    np.testing.assert_allclose(fit.R, np.eye(3), atol=0.2)


def test_without_scale_the_fit_is_rigid() -> None:
    truth = SE3.exp([1, 2, 3, 0.3, -0.2, 0.1])
    points = cloud()
    fit = umeyama(points, 2.0 * (truth @ points), with_scale=False)
    assert fit.scale == 1
    np.testing.assert_allclose(fit.R, truth.R, atol=1e-12)


def test_weights_of_zero_leave_points_out_and_whole_weights_repeat_them() -> None:
    points, noise = cloud(20), cloud(20, seed=1) * 0.05
    target = 1.3 * points + 0.2 + noise
    weights = np.r_[np.zeros(5), np.ones(10), np.full(5, 3.0)]
    repeated = np.repeat(np.arange(20), weights.astype(int))
    assert_same(
        umeyama(points, target, weights=weights), umeyama(points[repeated], target[repeated])
    )


def test_the_fit_is_the_least_squares_one() -> None:
    points, noise = cloud(30), cloud(30, seed=2) * 0.1
    target = points + noise
    best = umeyama(points, target)
    error = ((best @ points - target) ** 2).sum()
    for axis in range(6):
        step = SE3.exp(np.eye(6)[axis] * 1e-4)
        moved = Similarity(best.scale, step.R @ best.R, step.R @ best.t + step.t)
        assert ((moved @ points - target) ** 2).sum() > error
    for factor in (0.999, 1.001):
        centre = (best @ points).mean(axis=0)
        grown = factor * (best @ points - centre) + centre
        assert ((grown - target) ** 2).sum() > error


def test_a_camera_pose_is_carried_along() -> None:
    similarity = Similarity(2.0, so3_exp([0, 0, np.pi / 2]), np.array([1.0, 0, 0]))
    pose = SE3(np.eye(3), np.array([1.0, 0, 0]))
    moved = similarity.transform_pose(pose)
    np.testing.assert_allclose(moved.t, [1, 2, 0], atol=1e-15)
    point_in_camera = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(
        moved @ (2.0 * point_in_camera), similarity @ (pose @ point_in_camera), atol=1e-15
    )


LINE = np.linspace(0, 1, 10)[:, None] * [1.0, 2.0, 3.0]
REFUSED = {
    "two_points": (cloud(2), cloud(2)),
    "unequal": (cloud(5), cloud(6)),
    "planar_arrays": (cloud(5)[:, :2], cloud(5)[:, :2]),
    "line": (LINE, LINE),
    "far_line": (LINE + 1e5, LINE),
    "one_place": (np.ones((5, 3)) / 3, cloud(5)),
    "one_place_far_away": (np.full((5, 3), 1e6) + 1e-12, cloud(5)),
    "onto_one_place": (cloud(5), np.ones((5, 3)) / 3),
    "not_a_number": (np.where(cloud(5) > 0.05, np.nan, cloud(5)), cloud(5)),
    "infinite": (cloud(5), np.full((5, 3), np.inf)),
}


@pytest.mark.parametrize(("p", "q"), REFUSED.values(), ids=REFUSED.keys())
def test_points_that_leave_the_similarity_open_are_refused(p: np.ndarray, q: np.ndarray) -> None:
    with pytest.raises(ToolkitError):
        umeyama(p, q)
    with pytest.raises(ToolkitError):
        ransac_similarity(p, q, threshold_m=1e-6)


@pytest.mark.parametrize("weights", [np.zeros(9), np.full(9, np.nan), -np.ones(9), np.ones(3)])
def test_useless_weights_are_refused(weights: np.ndarray) -> None:
    with pytest.raises(ToolkitError, match="weights"):
        umeyama(cloud(9), cloud(9), weights=weights)


# --- outliers --------------------------------------------------------------------------------


def correspondences(share: float, seed: int) -> tuple:
    """A NOCS cloud and its observation in metres: 1 mm noise, a share of points 10 cm off."""
    rng = np.random.default_rng(seed)
    truth = Similarity(0.25, so3_exp(rng.normal(size=3)), np.array([0.1, -0.05, 0.7]))
    nocs = rng.uniform(-0.3, 0.3, (1000, 3))
    # The outliers lie on one side of the object, as background or glass does.
    nocs = nocs[np.argsort(nocs @ rng.normal(size=3))]
    seen = truth @ nocs + rng.normal(0, 0.001, (1000, 3))
    outliers = np.arange(1000) < 1000 * share
    direction = rng.normal(size=3)
    seen[outliers] += 0.1 * direction / np.linalg.norm(direction)
    return truth, nocs, seen, outliers


def rotation_error_deg(fit: Similarity, truth: Similarity) -> float:
    return float(np.degrees(rotation_angle(truth.R.T @ fit.R)))


def threshold_of_the_reference(p: np.ndarray, q: np.ndarray) -> float:
    """How the field's reference (NOCS, DREDS) chooses its threshold: a ratio of mean norms."""
    return float(np.linalg.norm(q, axis=1).mean() / np.linalg.norm(p, axis=1).mean())


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_outliers_cost_no_accuracy(share: float) -> None:
    errors = []
    for seed in range(20):
        truth, nocs, seen, outliers = correspondences(share, seed)
        fit, inliers = ransac_similarity(nocs, seen, threshold_m=0.005, seed=seed)
        clean = umeyama(nocs[~outliers], seen[~outliers])
        assert not inliers[outliers].any()
        assert inliers[~outliers].mean() > 0.99
        # Residuals of 5 sigma and more are cut, so the two fits differ by next to nothing.
        assert rotation_angle(clean.R.T @ fit.R) < np.radians(0.02)
        errors.append(rotation_error_deg(fit, truth))
    assert np.median(errors) < 0.1


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_a_threshold_from_norms_admits_every_point(share: float) -> None:
    """The defect of the reference, in metres as in millimetres: it never rejects anything."""
    errors = []
    for seed in range(20):
        truth, nocs, seen, _ = correspondences(share, seed)
        for unit in (1.0, 1000.0):
            threshold = threshold_of_the_reference(nocs, seen * unit)
            fit, inliers = ransac_similarity(nocs, seen * unit, threshold_m=threshold, seed=seed)
            assert inliers.all()
            np.testing.assert_allclose(fit.R, umeyama(nocs, seen).R, atol=1e-9)
        errors.append(rotation_error_deg(fit, truth))
    assert np.median(errors) > 3  # against less than 0.1 above


def test_the_mask_belongs_to_the_fit() -> None:
    _, nocs, seen, _ = correspondences(0.3, 0)
    fit, inliers = ransac_similarity(nocs, seen, threshold_m=0.002)
    again = umeyama(nocs[inliers], seen[inliers])
    np.testing.assert_array_equal(fit.matrix(), again.matrix())


def test_the_same_seed_gives_the_same_answer() -> None:
    _, nocs, seen, _ = correspondences(0.3, 1)
    a, _ = ransac_similarity(nocs, seen, threshold_m=0.005, seed=3)
    b, _ = ransac_similarity(nocs, seen, threshold_m=0.005, seed=3)
    np.testing.assert_array_equal(a.matrix(), b.matrix())


def test_nothing_but_outliers_is_an_error() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ToolkitError, match="no similarity explains three"):
        ransac_similarity(
            rng.normal(size=(50, 3)), rng.normal(size=(50, 3)), threshold_m=1e-9, max_iterations=50
        )


@pytest.mark.parametrize("threshold", [0.0, -1.0, np.nan])
def test_a_threshold_must_be_positive(threshold: float) -> None:
    with pytest.raises(ToolkitError, match="threshold_m: must be positive"):
        ransac_similarity(cloud(), cloud(), threshold_m=threshold)
