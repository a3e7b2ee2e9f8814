"""The transform between two worlds from points: wrong sets of points are refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_error
from std_toolkit.labels.carry.world_relation import Found, SharedPoints, relate_worlds

T_B_A = SE3.exp([0.4, -0.2, 0.7, 0.5, 1.0, -0.3])
ABOVE = np.array([0.0, 0.0, 0.8])


def points_of(
    a: NDArray, by: Found = "points", *, T: SE3 = T_B_A, noise_mm: float = 0.0, scale: float = 1.0
) -> SharedPoints:
    b = T @ (scale * a) + np.random.default_rng(5).normal(0, noise_mm / 1000, a.shape)
    return SharedPoints(by=by, a=a, b=b, eye_a=ABOVE, eye_b=T @ (scale * ABOVE))


def cloud(count: int, seed: int = 0) -> NDArray:
    return np.random.default_rng(seed).uniform([-0.3, -0.3, 0], [0.3, 0.3, 0.1], (count, 3))


def joined(*parts: SharedPoints) -> SharedPoints:
    a, b = np.concatenate([p.a for p in parts]), np.concatenate([p.b for p in parts])
    return SharedPoints(parts[0].by, a, b, parts[0].eye_a, parts[0].eye_b)


def test_three_points_and_their_deviation() -> None:
    a = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.1, 0.2, 0]])
    found = relate_worlds(points_of(a, noise_mm=1.0))
    assert found.count == 3
    assert 1000 * np.linalg.norm(found.T_b_a.t - T_B_A.t) < 4
    near, far = (found.deviation_mm(T_B_A @ np.array(p)) for p in ([0.1, 0.1, 0.1], [1.0, 0.5, 0]))
    assert 0.5 < near < 3 < far


def test_outliers_are_left_out_and_counted() -> None:
    wrong = SharedPoints("features", cloud(200, 1), cloud(200, 2), ABOVE, T_B_A @ ABOVE)
    found = relate_worlds(joined(points_of(cloud(100), "features", noise_mm=1.0), wrong))
    assert 95 <= found.count <= 105
    assert found.total == 300
    assert found.residual_mm == pytest.approx(np.sqrt(3), rel=0.2)
    assert np.degrees(rotation_error(found.T_b_a, T_B_A)) < 0.2


def test_wrong_point_of_four_is_named() -> None:
    a = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.1, 0.2, 0], [-0.1, 0.1, 0.05]])
    given = points_of(a)
    given.b[2] += [0.05, 0.0, 0.0]
    found = relate_worlds(given)
    assert found.notes == ("point 3 does not fit the others and was left out",)
    assert 1000 * np.linalg.norm(found.T_b_a.t - T_B_A.t) < 1e-6


def test_pattern_that_repeats_is_refused() -> None:
    shifted = SE3(T_B_A.R, T_B_A.t + np.array([0.1, 0.0, 0.0]))
    parts = points_of(cloud(50), "features"), points_of(cloud(45, 3), "features", T=shifted)
    with pytest.raises(ToolkitError, match=r"50 features agree on one .* 45 on another, 100 mm"):
        relate_worlds(joined(*parts))
    few = points_of(cloud(20, 3), "features", T=shifted)
    assert relate_worlds(joined(parts[0], few)).count == 50


def test_half_of_the_points_must_agree() -> None:
    parts = points_of(cloud(3)), points_of(cloud(3, 3), T=SE3.identity())
    with pytest.raises(ToolkitError, match="3 of 6 points agree") as told:
        relate_worlds(joined(*parts))
    assert "--points" in str(told.value.hint)


def test_points_of_other_places() -> None:
    parts = points_of(cloud(3))
    with pytest.raises(ToolkitError, match=r"their distances differ by up to \d+ mm"):
        relate_worlds(SharedPoints("points", parts.a, 1.3 * parts.b, ABOVE, parts.eye_b))


def test_interchanged_points_turn_the_surface_over() -> None:
    a = np.array([[0.0, 0.0, 0], [0.2, 0.1, 0], [0.2, -0.1, 0]])
    given = points_of(a)
    swapped = SharedPoints("points", a, given.b[[0, 2, 1]], given.eye_a, given.eye_b)
    with pytest.raises(ToolkitError, match="turned over"):
        relate_worlds(swapped)


def test_mirrored_points_do_not_fit() -> None:
    a = cloud(100)
    given = points_of(a * [1, 1, -1], "features")
    with pytest.raises(ToolkitError, match="cannot be related"):
        relate_worlds(SharedPoints("features", a * [1, 1, 3], given.b * 1.0, ABOVE, given.eye_b))


def test_points_on_a_line_or_too_few() -> None:
    line = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]])
    with pytest.raises(ToolkitError, match="no three points agree"):
        relate_worlds(points_of(line))
    with pytest.raises(ToolkitError, match="2 points, 3 are needed"):
        relate_worlds(points_of(line[:2]))
    with pytest.raises(ToolkitError, match="20 features, 30 are needed"):
        relate_worlds(points_of(cloud(20), "features"))


def test_difference_of_the_scales_is_told_or_refused() -> None:
    flat = cloud(300) * [0.5, 0.5, 1.0]
    found = relate_worlds(points_of(flat, "features", scale=1.01))
    assert found.notes == ("the scales of the two scenes differ by 1.0 %: refine the poses",)
    with pytest.raises(ToolkitError, match="the scales of the two scenes differ"):
        relate_worlds(points_of(flat * 0.3, "features", scale=1.05))
