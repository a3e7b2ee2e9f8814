"""Depth residuals, raw errors, consistency over frames and coverage against known answers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_balls import CAMERA, CENTRES, arc_pose

from std_toolkit.checks.measure.coverage import directions, measure_coverage, scene_up
from std_toolkit.checks.measure.edges import fit_consistency, shift_jacobian
from std_toolkit.checks.measure.sensor_depth import ErrorTally, depth_residual


def test_depth_residual_is_the_bias() -> None:
    rng = np.random.default_rng(0)
    rendered = np.full((60, 80), 0.7) + 0.01 * rng.random((60, 80))
    sensor = rendered - 0.004 + 0.001 * rng.standard_normal(rendered.shape)
    mask = np.zeros(rendered.shape, bool)
    mask[10:50, 10:70] = True
    # Mixed pixels along the outline, and holes, must not count.
    sensor[8:12] = 1.5
    sensor[20:30, 20:30] = 0
    found = depth_residual(rendered, sensor, mask)
    assert found is not None
    assert found.median_m == pytest.approx(0.004, abs=2e-4)
    assert found.mad_m == pytest.approx(0.6745 * 0.001, rel=0.1)
    assert found.depth_m == pytest.approx(0.705, abs=1e-3)


def test_depth_residual_needs_pixels() -> None:
    depth = np.full((60, 80), 0.7)
    mask = np.zeros(depth.shape, bool)
    mask[10:20, 10:20] = True
    assert depth_residual(depth, depth, mask) is None
    assert depth_residual(depth, np.zeros_like(depth), np.ones_like(mask)) is None


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.floats(-0.4, 0.4), min_size=1, max_size=200),
    st.integers(0, 50),
    st.integers(0, 200),
)
def test_error_tally_agrees_with_numpy(errors: list[float], holes: int, cut: int) -> None:
    truth = np.full(len(errors) + holes, 1.0)
    raw = np.concatenate([1.0 + np.array(errors), np.zeros(holes)])
    whole, first, second = ErrorTally(), ErrorTally(), ErrorTally()
    whole.add(raw, truth)
    first.add(raw[:cut], truth[:cut])
    second.add(raw[cut:], truth[cut:])
    first.merge(second)
    for tally in (whole, first):
        assert tally.completeness == pytest.approx(len(errors) / len(truth))
        assert tally.mae_m == pytest.approx(np.abs(errors).mean(), abs=1e-9)
        assert tally.rmse_m == pytest.approx(np.sqrt(np.mean(np.square(errors))), abs=1e-9)
        low, high = (
            np.quantile(errors, 0.5, method="lower"),
            np.quantile(errors, 0.5, method="higher"),
        )
        assert low - 6e-4 <= tally.quantile_m(0.5) <= high + 6e-4


def test_error_tally_without_pixels_or_readings() -> None:
    empty = ErrorTally()
    assert empty.completeness is None and empty.quantile_m(0.5) is None and empty.rmse_m is None
    blind = ErrorTally()
    blind.add(np.zeros(5), np.ones(5))
    assert blind.completeness == 0 and blind.mae_m is None and blind.quantile_m(0.5) is None
    assert blind.share_within(0.01) == 0


def test_share_within_counts_missing_readings_as_misses() -> None:
    tally = ErrorTally()
    tally.add(np.array([1.001, 1.2, 0.0, 0.996]), np.ones(4))
    assert tally.share_within(0.01) == 0.5


@pytest.mark.parametrize(("error", "bin_"), [(0.0, 1000), (0.25, 1500), (-0.25, 500)])
def test_a_bin_of_depth_errors_holds_its_lower_end(error: float, bin_: int) -> None:
    tally = ErrorTally()
    tally.add(np.array([1.0 + error]), np.ones(1))
    assert tally.histogram is not None
    assert np.flatnonzero(tally.histogram).tolist() == [bin_]


def test_the_outermost_bins_of_depth_errors_hold_the_rest() -> None:
    tally = ErrorTally()
    tally.add(np.array([0.5, 0.25, 1.5, 3.0]), np.ones(4))
    assert tally.histogram is not None
    assert (tally.histogram[0], tally.histogram[-1], tally.histogram.sum()) == (2, 2, 4)


def _views(count: int, arc_deg: float):
    poses = [arc_pose(a) for a in np.linspace(-arc_deg / 2, arc_deg / 2, count)]
    pairs = [shift_jacobian(CAMERA, T, CENTRES[1]) for T in poses]
    return poses, np.stack([J for J, _ in pairs]), np.array([z / CAMERA.fx for _, z in pairs])


def test_shift_jacobian_agrees_with_projection() -> None:
    T = arc_pose(20)
    J, _ = shift_jacobian(CAMERA, T, CENTRES[1])
    step = 1e-6
    for axis in range(3):
        d = np.eye(3)[axis] * step
        moved = [CAMERA.project(T.inverse() @ (CENTRES[1] + s * d)) for s in (1, -1)]
        assert (moved[0] - moved[1]) / (2 * step) == pytest.approx(J[:, axis], rel=1e-5, abs=1e-3)


def test_one_displacement_is_found_and_leaves_no_drift() -> None:
    _, J, size = _views(12, 90)
    offset = np.array([0.004, -0.003, 0.002])
    rng = np.random.default_rng(1)
    shifts = J @ offset + 0.1 * rng.standard_normal((12, 2))
    shifts[3] = [9.0, -7.0]  # caught another edge
    found = fit_consistency(shifts, J, size)
    assert found is not None
    assert np.array(found.offset_m) == pytest.approx(offset, abs=3e-4)
    assert found.drift_px < 0.2


def test_drift_is_not_explained_away() -> None:
    _, J, size = _views(12, 90)
    angle = np.linspace(0, 2.5 * np.pi, 12)
    found = fit_consistency(4 * np.stack([np.cos(angle), np.sin(angle)], axis=1), J, size)
    assert found is not None
    assert found.drift_px > 2
    assert found.drift_m == pytest.approx(found.drift_px * size.mean(), rel=0.2)


def test_two_frames_tell_nothing_about_drift() -> None:
    _, J, size = _views(2, 90)
    assert fit_consistency(np.zeros((2, 2)), J, size) is None


def test_directions_and_gaps() -> None:
    up, ahead = np.array([0.0, 0, 1]), np.array([1.0, 0, 0])
    angles = np.deg2rad([0, 10, 20, 90])
    cameras = np.stack([np.cos(angles), np.sin(angles), np.ones(4)], axis=1)
    azimuth, elevation = directions(np.zeros(3), cameras, up, ahead)
    assert azimuth == pytest.approx([0, 10, 20, 90])
    assert elevation == pytest.approx(45)
    found = measure_coverage(azimuth, elevation)
    assert found is not None
    assert found.azimuth_span_deg == pytest.approx(90)
    assert found.largest_step_deg == pytest.approx(70)
    assert found.parallax_deg == pytest.approx(60)


def test_span_over_the_zero_direction() -> None:
    found = measure_coverage(np.array([350.0, 10.0, 0.0]), np.zeros(3))
    assert found is not None and found.azimuth_span_deg == pytest.approx(20)
    one = measure_coverage(np.array([42.0]), np.array([5.0]))
    assert one is not None and one.azimuth_span_deg == 0 and one.parallax_deg == 0
    assert measure_coverage(np.array([]), np.array([])) is None


def test_up_is_the_tables_normal() -> None:
    rng = np.random.default_rng(0)
    table = np.stack([rng.uniform(-1, 1, 2000), 0.002 * rng.standard_normal(2000),
                      rng.uniform(-1, 1, 2000)], axis=1)  # fmt: skip
    clutter = rng.uniform(-0.2, 0.2, (400, 3)) + np.array([0, 0.2, 0])
    down = np.deg2rad(40)
    tilt = np.array([[1, 0, 0], [0, np.cos(down), -np.sin(down)], [0, np.sin(down), np.cos(down)]])
    poses = []
    for angle in (-30.0, 0.0, 30.0):
        T = arc_pose(angle)
        poses.append(type(T)(T.R @ tilt.T, T.t + np.array([0, 0.4, 0])))
    up = scene_up(poses, np.concatenate([table, clutter]))
    assert up @ [0, 1, 0] > 0.999
    # Without points the way the camera was held must do.
    assert np.linalg.norm(scene_up(poses, None)) == pytest.approx(1)
    assert scene_up([], None) == pytest.approx([0, -1, 0])
