"""Planes: signed distances, change of frame, robust fits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.plane_fit import connected_patch, find_planes, refine_plane
from std_toolkit.labels.support.plane import Plane

TWISTS = st.lists(st.floats(-2, 2), min_size=6, max_size=6)


def test_signed_distance_is_positive_on_the_side_of_the_normal() -> None:
    table = Plane(np.array([0.0, 0.0, 2.0]), -0.6)
    assert table.normal.tolist() == [0, 0, 1]
    assert table.signed_distance([[5, 7, 0.3], [0, 0, 0.5], [0, 0, 0]]) == pytest.approx(
        [0, 0.2, -0.3]
    )
    assert table.project([1.0, 2.0, 0.5]) == pytest.approx([1, 2, 0.3])


@given(TWISTS, TWISTS)
def test_a_moved_plane_keeps_the_distances_of_moved_points(a: list[float], b: list[float]) -> None:
    plane = Plane(SE3.exp(b).R[0], 0.3)
    T = SE3.exp(a)
    points = np.random.default_rng(0).normal(size=(5, 3))
    moved = plane.moved(T, "camera 3")
    assert moved.frame == "camera 3"
    assert moved.signed_distance(T @ points) == pytest.approx(
        plane.signed_distance(points), abs=1e-9
    )


@pytest.mark.parametrize("normal", [[0, 0, 0], [np.nan, 0, 1], [1, 0]])
def test_what_is_no_plane_is_refused(normal: list[float]) -> None:
    with pytest.raises(ToolkitError, match="a plane needs a normal"):
        Plane(np.array(normal), 0.0)


def noisy_plane(rng: np.random.Generator, normal: np.ndarray, offset: float, n: int) -> np.ndarray:
    side = np.linalg.svd(normal[None])[2][1:]
    flat = rng.uniform(-0.4, 0.4, (n, 2)) @ side
    return flat - offset * normal + rng.normal(0, 0.001, (n, 1)) * normal


@settings(max_examples=6, deadline=None)
@given(TWISTS)
def test_the_larger_of_two_planes_comes_first_whatever_the_clutter(twist: list[float]) -> None:
    rng = np.random.default_rng(1)
    R = SE3.exp(twist).R
    points = np.concatenate(
        [
            noisy_plane(rng, R[2], -0.5, 3000),
            noisy_plane(rng, R[0], 0.3, 1500),
            rng.uniform(-1, 1, (3000, 3)),
        ]
    )
    sigma, weight = np.full(len(points), 0.0015), np.ones(len(points))
    first, second = find_planes(points, sigma, weight, count=4)[:2]
    assert abs(first.normal @ R[2]) > np.cos(np.radians(0.1))
    assert abs(first.offset) == pytest.approx(0.5, abs=5e-4)
    assert abs(second.normal @ R[0]) > np.cos(np.radians(0.2))
    assert first.weight > second.weight > 0.15
    assert first.rms_m < 0.0015


def test_outliers_on_one_side_do_not_pull_the_fit() -> None:
    rng = np.random.default_rng(2)
    table = noisy_plane(rng, np.array([0.0, 0.0, 1.0]), 0.0, 2000)
    objects = rng.uniform([-0.2, -0.2, 0.01], [0.2, 0.2, 0.1], (1000, 3))
    points = np.concatenate([table, objects])
    start = np.array([0.02, 0.0, 1.0]) / np.linalg.norm([0.02, 0.0, 1.0])
    normal, offset = refine_plane(points, np.full(3000, 0.0015), np.ones(3000), start, 0.004)
    assert np.degrees(np.arccos(normal[2])) < 0.05
    assert abs(offset) < 3e-4


def test_noise_alone_is_no_plane() -> None:
    points = np.random.default_rng(3).uniform(-1, 1, (5000, 3))
    assert find_planes(points, np.full(5000, 0.002), np.ones(5000), count=3) == []


def test_a_table_ends_where_its_surface_does() -> None:
    """Chair backs at the height of the table belong to its plane, but not to the table."""
    rng = np.random.default_rng(4)
    table = noisy_plane(rng, np.array([0.0, 0.0, 1.0]), 0.0, 3000)
    chair = rng.uniform([1.0, 0.0, -0.008], [1.1, 0.5, 0.008], (500, 3))
    points = np.concatenate([table, chair])
    sigma, weight = np.full(3500, 0.004), np.ones(3500)
    whole = find_planes(points, sigma, weight, count=1)[0]
    assert whole.inliers[3000:].all()
    patch = connected_patch(points, weight, whole, sigma, cell_m=0.05)
    assert not patch.inliers[3000:].any()
    assert patch.inliers[:3000].mean() > 0.99
    assert patch.rms_m < 0.0012
