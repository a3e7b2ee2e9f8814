"""Poses fitted to normalised coordinates and points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.methods.pose.fitting import FitMethod, FitOptions, fit_pose
from benchmark.metrics.pose import box_iou, rotation_errors_deg, translation_errors_cm
from std_toolkit.errors import ToolkitError

PAPER = FitOptions(fit=FitMethod.PAPER)
DIAGONAL_M = 0.2


def seen(seed: int, *, share: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates and points of the visible half of an ellipsoid, and its true pose.

    `share` of the points lie 10 cm behind, as a sensor has it that looks through glass.
    """
    rng = np.random.default_rng(seed)
    c = rng.normal(size=(2000, 3))
    c *= np.array([0.25, 0.35, 0.25]) / np.linalg.norm(c, axis=1, keepdims=True)
    R = Rotation.random(rng=rng).as_matrix()
    c = c[(c @ R.T)[:, 2] < 0]
    RT = np.eye(4)
    RT[:3, :3], RT[:3, 3] = DIAGONAL_M * R, (0.05, -0.02, 0.7)
    points = c @ RT[:3, :3].T + RT[:3, 3] + rng.normal(0, 0.001, c.shape)
    points[rng.random(len(c)) < share] *= 0.8 / 0.7
    return c, points, RT


def errors(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    pair = found[None], true[None]
    return float(rotation_errors_deg(*pair)[0]), float(translation_errors_cm(*pair)[0])


@pytest.mark.parametrize("options", [None, PAPER])
def test_without_outliers(options: FitOptions | None) -> None:
    c, points, RT = seen(0)
    found = fit_pose(c, points, options)
    degrees, cm = errors(found.RT, RT)
    assert degrees < 0.2
    assert cm < 0.05
    assert found.inliers.all()
    assert np.linalg.norm(found.size) == pytest.approx(1)
    # The scale inside is the diagonal of the box, whose sides are 2 * 0.25, 2 * 0.35, 2 * 0.25.
    sides = np.cbrt(np.linalg.det(found.RT[:3, :3])) * found.size
    assert sides == pytest.approx(DIAGONAL_M * np.array([0.5, 0.7, 0.5]), rel=0.02)
    true_box = RT[None], np.array([[0.5, 0.7, 0.5]])
    assert box_iou(found.RT[None], found.size[None], *true_box)[0] > 0.93


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_outliers_move_least_squares_only(share: float) -> None:
    both = []
    for seed in range(6):
        c, points, RT = seen(seed, share=share)
        both.append([errors(fit_pose(c, points, o).RT, RT) for o in (None, PAPER)])
        inliers = fit_pose(c, points).inliers
        assert inliers.mean() == pytest.approx(1 - share, abs=0.04)
    (degrees, cm), (paper_degrees, paper_cm) = np.median(both, axis=0)
    assert degrees < 0.3
    assert cm < 0.1
    assert paper_cm > 5 * cm
    assert paper_degrees > 2 * degrees


def test_the_threshold_is_in_metres() -> None:
    """The same object three times as far and large: 2 cm is 2 cm."""
    c, points, _ = seen(1, share=0.3)
    assert fit_pose(3 * c, 3 * points, FitOptions(threshold_m=0.06)).inliers.mean() < 0.8
    wide = fit_pose(c, points, FitOptions(threshold_m=3.0, last="inliers"))
    assert wide.inliers.all()
    np.testing.assert_allclose(wide.RT, fit_pose(c, points, PAPER).RT, atol=1e-9)


def test_the_last_fit_has_the_scale_of_the_errors() -> None:
    """On a small object 2 cm accept the table behind it; the weighted fit does not."""
    rng = np.random.default_rng(4)
    c = rng.uniform(-0.3, 0.3, (600, 3))
    points = 0.05 * c + np.array([0.0, 0.0, 0.5]) + rng.normal(0, 2e-4, c.shape)
    points[:150, 2] += 0.012  # as seen through glass
    errors = []
    for last in ("inliers", "tukey"):
        RT = fit_pose(c, points, FitOptions(last=last)).RT
        errors.append(1000 * np.linalg.norm(RT[:3, 3] - [0, 0, 0.5]))
    assert errors[0] > 1 and errors[1] < 0.1


def test_it_is_the_same_each_time() -> None:
    c, points, _ = seen(2, share=0.3)
    assert (fit_pose(c, points).RT == fit_pose(c, points).RT).all()


def test_what_cannot_be_fitted() -> None:
    line = np.outer(np.arange(10.0), (0.1, 0.0, 0.0))
    for c, points in ((line, line), (line[:2], line[:2])):
        with pytest.raises(ToolkitError):
            fit_pose(c, points)
        nothing = fit_pose(c, points, PAPER)
        np.testing.assert_array_equal(nothing.RT, np.eye(4))
        assert not nothing.inliers.any()
    with pytest.raises(ToolkitError, match="two equal arrays"):
        fit_pose(line, line[:5])
    with pytest.raises(ToolkitError, match="not finite"):
        fit_pose(line, line * np.nan)
    with pytest.raises(ToolkitError, match="threshold_m"):
        FitOptions(threshold_m=0)
