"""Random viewpoints keep their ranges, and the image's frame is what the conventions say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.viewpoints.views import ViewpointOptions, look_at, random_viewpoints
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera

CAMERA = Camera(640, 360, 446.31, 446.31, 319.5, 179.5)


@st.composite
def choices(draw: st.DrawFn) -> ViewpointOptions:
    near = draw(st.floats(0.2, 1.0))
    tilt = sorted(draw(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))))
    return ViewpointOptions(
        count=6,
        distance_m=(near, near + draw(st.floats(0, 0.5))),
        sideways=draw(st.floats(0, 0.7)),
        target_m=(draw(st.floats(-1, 1)), draw(st.floats(-1, 1)), draw(st.floats(0, 0.3))),
        jitter_m=draw(st.floats(0, 0.1)),
        up_x=(tilt[0], tilt[1]),
        up_y=(tilt[0], tilt[1]),
    )


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**40), options=choices())
def test_every_view_keeps_the_ranges(seed: int, options: ViewpointOptions) -> None:
    views = random_viewpoints(seed, options)
    assert len(views) == options.count
    for view in views:
        T = view.T_world_cam
        np.testing.assert_allclose(T.R @ T.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(T.R) == pytest.approx(1)
        assert options.distance_m[0] - 1e-12 <= view.distance_m <= options.distance_m[1] + 1e-12
        assert view.elevation_rad >= options.least_elevation_rad - 1e-6
        assert np.abs(view.target_m - options.target_m).max() <= options.jitter_m + 1e-12
        # The point that the camera looks at is in the middle of the image, at its distance.
        seen = T.inverse() @ view.target_m
        np.testing.assert_allclose(seen, [0, 0, view.distance_m], atol=1e-9)
        # Up in the world is up in the image (y points down), and has no part across it.
        up = T.R.T @ view.up
        assert up[1] < 0
        assert abs(up[0]) < 1e-9


def test_the_defaults_are_those_of_dreds() -> None:
    views = [v for seed in range(60) for v in random_viewpoints(seed)]
    assert len(views) == 60 * 30
    distances = np.array([v.distance_m for v in views])
    assert 0.5 <= distances.min() < 0.502
    assert 0.948 < distances.max() <= 0.95
    elevations = np.degrees([v.elevation_rad for v in views])
    assert 31.9 <= elevations.min() < 36
    outward = np.array([(v.T_world_cam.t - v.target_m) / v.distance_m for v in views])
    for axis in (0, 1):
        assert np.abs(outward[:, axis]).max() <= 0.6
        # Uniform: the standard deviation of U(-a, a) is a / sqrt(3).
        assert outward[:, axis].std() == pytest.approx(0.6 / np.sqrt(3), rel=0.04)
    targets = np.array([v.target_m for v in views])
    assert np.abs(targets).max() <= 0.05
    assert targets.std() == pytest.approx(0.05 / np.sqrt(3), rel=0.04)
    ups = np.array([v.up for v in views])
    assert np.abs(ups[:, :2]).max() <= 0.18
    assert ups[:, 0].std() == pytest.approx(0.18 / np.sqrt(3), rel=0.06)


def test_a_view_depends_on_the_seed_and_its_number_alone() -> None:
    few = random_viewpoints(7, ViewpointOptions(count=3))
    many = random_viewpoints(7, ViewpointOptions(count=12))
    for a, b in zip(few, many, strict=False):
        assert a.T_world_cam.flat() == b.T_world_cam.flat()
    firsts = {random_viewpoints(s, ViewpointOptions(count=1))[0].distance_m for s in range(20)}
    assert len(firsts) == 20
    assert len({v.distance_m for v in many}) == 12


def test_straight_from_above_there_is_still_an_image() -> None:
    options = ViewpointOptions(sideways=0.0, up_x=(0, 0), up_y=(0, 0), count=2)
    for view in random_viewpoints(0, options):
        np.testing.assert_allclose(view.T_world_cam.R[:, 2], [0, 0, -1], atol=1e-12)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("count", 0),
        ("distance_m", (0.9, 0.5)),
        ("distance_m", (0.0, 0.5)),
        ("distance_m", (0.5, float("nan"))),
        ("sideways", 0.8),
        ("jitter_m", -0.1),
        ("target_m", (0, 0, float("nan"))),
        ("up_x", (0.2, -0.2)),
        ("up_y", (-2, 0)),
    ],
)
def test_senseless_ranges_are_refused(field: str, value: object) -> None:
    with pytest.raises(ToolkitError, match=field):
        ViewpointOptions(**{field: value})  # type: ignore[arg-type]


def test_a_camera_that_sees_nothing_is_refused() -> None:
    with pytest.raises(ToolkitError, match="stands at the point"):
        look_at([1, 2, 3], [1, 2, 3])
    with pytest.raises(ToolkitError, match="along its up vector"):
        look_at([0, 0, 1], [0, 0, 0])
    with pytest.raises(ToolkitError, match="seed"):
        random_viewpoints(-1)
