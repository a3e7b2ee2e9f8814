"""Trajectories are smooth, keep their ranges and do not depend on how finely they are sampled."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.viewpoints.camera_path import TrajectoryOptions, smooth_trajectory
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import rotation_angle

ARC = TrajectoryOptions()
SPIRAL = TrajectoryOptions(kind="spiral", sweep_deg=720, elevation_deg=(25, 70), frames=200)


def polar(poses, options):
    """Azimuth (unwrapped), elevation in degrees and distance of the camera from the target."""
    out = np.array([T.t for T in poses]) - options.target_m
    distance = np.linalg.norm(out, axis=1)
    azimuth = np.degrees(np.unwrap(np.arctan2(out[:, 1], out[:, 0])))
    return azimuth, np.degrees(np.arcsin(out[:, 2] / distance)), distance


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**40), options=st.sampled_from([ARC, SPIRAL]))
def test_ranges_are_kept(seed, options) -> None:
    poses = smooth_trajectory(seed, options)
    assert len(poses) == options.frames
    azimuth, elevation, distance = polar(poses, options)
    sway = np.sqrt(3) * options.sway_m
    assert distance.min() >= options.distance_m[0] - sway
    assert distance.max() <= options.distance_m[1] + sway
    slack = np.degrees(sway / options.distance_m[0])
    assert elevation.min() >= options.elevation_deg[0] - slack
    assert elevation.max() <= options.elevation_deg[1] + slack
    assert azimuth[-1] - azimuth[0] == pytest.approx(options.sweep_deg, abs=4 * slack)
    for T in poses:
        np.testing.assert_allclose(T.R @ T.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(T.R) == pytest.approx(1)
        # The target stays near the optical axis: within the drift at its distance.
        seen = T.inverse() @ np.array(options.target_m)
        assert np.hypot(*seen[:2]) <= np.sqrt(3) * options.drift_m + 1e-9
        # The image stands upright but for the roll.
        up = T.R.T @ np.array([0, 0, 1.0])
        assert up[1] < 0
        assert abs(np.degrees(np.arctan2(up[0], -up[1]))) <= options.roll_deg + 1e-6


@pytest.mark.parametrize("options", [ARC, SPIRAL], ids=["arc", "spiral"])
@pytest.mark.parametrize("seed", range(5))
def test_sampled_more_finely_it_is_the_same_smooth_way(options, seed) -> None:
    """Of a way with continuous acceleration, steps halve and second differences quarter."""
    coarse = smooth_trajectory(seed, replace(options, frames=401))
    fine = smooth_trajectory(seed, replace(options, frames=801))
    for a, b in zip(coarse, fine[::2], strict=True):
        np.testing.assert_allclose(a.matrix(), b.matrix(), atol=1e-12)

    def largest(poses, order):
        return np.abs(np.diff([T.t for T in poses], n=order, axis=0)).max()

    assert largest(coarse, 1) / largest(fine, 1) == pytest.approx(2, rel=0.05)
    assert largest(coarse, 2) / largest(fine, 2) == pytest.approx(4, rel=0.10)
    # No jump of the acceleration either: its change from step to step shrinks with the step.
    assert largest(coarse, 3) / largest(fine, 3) > 6
    turns = [
        [rotation_angle(a.R.T @ b.R) for a, b in itertools.pairwise(p)] for p in (coarse, fine)
    ]
    assert max(turns[0]) / max(turns[1]) == pytest.approx(2, rel=0.05)


def test_a_hand_sways_and_an_arm_on_rails_does_not() -> None:
    still = replace(
        ARC, sway_m=0, drift_m=0, roll_deg=0, distance_m=(0.6, 0.6), elevation_deg=(45, 45)
    )
    _, elevation, distance = polar(smooth_trajectory(3, still), still)
    np.testing.assert_allclose(distance, 0.6, atol=1e-12)
    np.testing.assert_allclose(elevation, 45, atol=1e-9)
    moved = smooth_trajectory(3, replace(still, sway_m=0.004))
    off = [a.t - b.t for a, b in zip(moved, smooth_trajectory(3, still), strict=True)]
    assert 0.002 < np.abs(off).max() <= 0.004


def test_a_spiral_climbs_from_bottom_to_top() -> None:
    level = replace(SPIRAL, sway_m=0)
    _, elevation, _ = polar(smooth_trajectory(1, level), level)
    assert elevation[0] == pytest.approx(25)
    assert elevation[-1] == pytest.approx(70)
    assert (np.diff(elevation) > 0).all()


def test_the_seed_decides() -> None:
    a, b, c = (smooth_trajectory(s, replace(ARC, frames=5)) for s in (4, 4, 5))
    assert [T.flat() for T in a] == [T.flat() for T in b]
    assert np.linalg.norm(a[0].t - c[0].t) > 0.01
    fixed = [
        polar(smooth_trajectory(s, replace(ARC, start_deg=-60, sway_m=0)), ARC)[0][0]
        for s in (1, 2)
    ]
    assert fixed == pytest.approx([-60, -60])


def test_a_single_frame_is_a_way_too() -> None:
    assert len(smooth_trajectory(0, replace(ARC, frames=1))) == 1


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("kind", "zigzag"),
        ("frames", 0),
        ("sways", 0),
        ("sweep_deg", 0),
        ("distance_m", (0.7, 0.6)),
        ("distance_m", (0.01, 0.6)),
        ("elevation_deg", (60, 50)),
        ("elevation_deg", (-10, 50)),
        ("elevation_deg", (10, 89)),
        ("sway_m", -1),
        ("roll_deg", float("nan")),
    ],
)
def test_senseless_ways_are_refused(field, value) -> None:
    with pytest.raises(ToolkitError, match=field):
        TrajectoryOptions(**{field: value})
