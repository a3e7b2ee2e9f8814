"""Scale from points of known size: exact on perfect pixels, robust to bad ones."""

from __future__ import annotations

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.poses import known_points
from std_toolkit.poses.known_points import (
    BodyFit,
    KnownView,
    fit_body,
    scale_from_known_points,
)

CAMERA = Camera(640, 480, 600.0, 600.0, 320.0, 240.0, (-0.04, 0.03, 0.0, 0.001))
UNIT = 0.25


def look_at(eye: np.ndarray) -> SE3:
    z = -eye / np.linalg.norm(eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return SE3(np.stack([x, np.cross(z, x), z], axis=1), eye)


def views(count: int, *, noise: float = 0.0, seed: int = 0) -> list[KnownView]:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.1, 0.1, size=(30, 3))
    T_model = SE3.exp(rng.normal(size=6) * 0.3)
    out = []
    for a in np.linspace(-0.8, 0.8, count):
        eye = np.array([0.7 * np.sin(a), -0.7 * np.cos(a), 0.4])
        T_body_cam = look_at(eye)
        uv = CAMERA.project(T_body_cam.inverse() @ points)
        uv = uv + rng.normal(0, noise, uv.shape)
        T_cam_body = T_body_cam.inverse()
        # The model's world: the metric one moved by T_model and divided by UNIT.
        T_cam_metric = T_cam_body @ T_model.inverse()
        T_cam_model = SE3(T_cam_metric.R, T_cam_metric.t / UNIT)
        out.append(KnownView(T_cam_model, CAMERA, np.arange(30), points, uv))
    return out


def test_exact_on_perfect_pixels() -> None:
    fit = fit_body(views(4), threshold_m=0.02)
    assert fit.scale == pytest.approx(UNIT, rel=1e-6)
    assert fit.rms_px < 1e-4


def test_noise_and_a_wrong_view() -> None:
    noisy = views(12, noise=0.5)
    wrong = noisy[5]
    noisy[5] = KnownView(wrong.T_cam_world, CAMERA, wrong.ids, wrong.xyz, wrong.uv + 60)
    estimate = scale_from_known_points(noisy, source="board", note="test", threshold_m=0.02)
    assert estimate.factor == pytest.approx(UNIT, rel=3e-3)
    assert 0 < estimate.standard_error < 0.01
    assert estimate.count == 12 * 30


@pytest.mark.slow
def test_standard_error_covers_the_truth() -> None:
    inside = 0
    for seed in range(10):
        e = scale_from_known_points(
            views(8, noise=1.0, seed=seed), source="b", note="", threshold_m=0.03
        )
        inside += abs(e.factor / UNIT - 1) < 3 * e.standard_error
    assert inside >= 8


def test_one_view_is_refused() -> None:
    with pytest.raises(ToolkitError, match="at least 2 registered frames"):
        fit_body(views(1), threshold_m=0.02)


def test_a_refit_finds_the_scale_from_a_wrong_start() -> None:
    exact = fit_body(views(4), threshold_m=0.02)
    off = BodyFit(1.05 * exact.scale, exact.T_world_body, exact.rms_px)
    assert known_points._refit(views(4), off) == pytest.approx(UNIT, rel=1e-6)


def test_points_are_triangulated_where_they_are() -> None:
    seen = views(3)
    _, model, body = known_points.triangulate_points(seen)
    np.testing.assert_allclose(body, seen[0].xyz)
    for view in seen:
        pixels = CAMERA.project(view.T_cam_world @ model)
        np.testing.assert_allclose(pixels, view.uv, atol=1e-4)


def test_few_views_are_taken_by_pairs_and_many_in_groups() -> None:
    assert [len(known_points._subsets(views(n))) for n in (2, 4, 6)] == [1, 6, 15]
    groups = known_points._subsets(views(7))
    assert [len(group) for group in groups] == [4, 3]
