from __future__ import annotations

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3, rotation_angle
from std_toolkit.labels.entry.pnp import solve_pnp

CAMERA = Camera(640, 480, 600.0, 605.0, 322.0, 238.0, (0.05, -0.02, 0.001, -0.001, 0.0))
POSE = SE3.from_quat(
    np.array([0.8, 0.2, -0.5, 0.26]) / np.linalg.norm([0.8, 0.2, -0.5, 0.26]), [0.03, -0.02, 0.7]
)


def points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.06, 0.06, (count, 3))


@pytest.mark.parametrize("count", [4, 6, 20])
def test_exact_correspondences_give_the_exact_pose(count):
    X = points(count)
    result = solve_pnp(X, CAMERA.project(POSE @ X), CAMERA)
    assert rotation_angle(result.T_cam_obj.R.T @ POSE.R) < 1e-6
    assert np.abs(result.T_cam_obj.t - POSE.t).max() < 1e-6
    assert result.rmse_px < 1e-4 and result.inliers.all()


def test_subpixel_noise_and_outliers():
    rng = np.random.default_rng(1)
    X = points(20)
    uv = CAMERA.project(POSE @ X) + rng.normal(0, 0.3, (20, 2))
    uv[:6] += rng.uniform(20, 60, (6, 2))
    result = solve_pnp(X, uv, CAMERA)
    assert not result.inliers[:6].any() and result.inliers[6:].all()
    assert np.rad2deg(rotation_angle(result.T_cam_obj.R.T @ POSE.R)) < 0.5
    error = result.T_cam_obj.t - POSE.t
    assert np.linalg.norm(error) < 0.005
    std = np.sqrt(np.diag(result.covariance))
    assert 0.1e-3 < np.linalg.norm(std[:3]) < 0.01


def test_pixels_are_not_rounded():
    X = points(8)
    uv = CAMERA.project(POSE @ X)
    exact, rounded = solve_pnp(X, uv, CAMERA), solve_pnp(X, np.rint(uv), CAMERA)
    assert np.linalg.norm(exact.T_cam_obj.t - POSE.t) < 1e-6
    assert np.linalg.norm(rounded.T_cam_obj.t - POSE.t) > 1e-4


def test_planar_points_seen_at_an_angle():
    X = points(8) * [1, 1, 0]
    result = solve_pnp(X, CAMERA.project(POSE @ X), CAMERA)
    assert np.abs(result.T_cam_obj.t - POSE.t).max() < 1e-5


@pytest.mark.parametrize(
    ("X", "message"),
    [
        (points(3), "at least 4"),
        (np.outer(np.arange(6), [0.01, 0.02, 0.01]), "line"),
        (np.repeat(points(1), 6, axis=0), "line or at one position"),
    ],
)
def test_degenerate_input_is_refused(X, message):
    with pytest.raises(ToolkitError, match=message):
        solve_pnp(X, CAMERA.project(POSE @ X) if len(X) else X[:, :2], CAMERA)


def test_correspondences_in_the_wrong_order_are_refused():
    X = points(8)
    with pytest.raises(ToolkitError, match="agree on a pose"):
        solve_pnp(X, CAMERA.project(POSE @ X)[::-1], CAMERA)


def test_an_ambiguous_plane_is_refused():
    # A far, small square seen almost frontally flips about its own axes for half a pixel.
    X = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.02
    pose = SE3.exp(np.array([0, 0, 1.2, 0.25, 0.1, 0])) @ SE3.identity()
    uv = CAMERA.project(pose @ X) + np.random.default_rng(0).normal(0, 0.3, (4, 2))
    with pytest.raises(ToolkitError, match=r"two different poses|do not determine the rotation"):
        solve_pnp(X, uv, CAMERA)
