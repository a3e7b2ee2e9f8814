"""Scale from sensor depth: z over z is exact, z over range is not."""

from __future__ import annotations

import numpy as np
import pytest

from std_toolkit.geometry import SE3, Camera
from std_toolkit.poses.colmap import Observations
from std_toolkit.poses.scale_sources import summarise, z_ratios

CAMERA = Camera(640, 480, 600.0, 600.0, 320.0, 240.0)
UNIT = 0.37  # metres per unit of the model


def perfect_view(seed: int = 0) -> tuple[np.ndarray, Observations]:
    """A tilted plane: z-depth image in metres and points on it in units of the model."""
    rng = np.random.default_rng(seed)
    rays = CAMERA.rays()
    normal, offset = np.array([0.1, -0.4, 1.0]), 0.7
    depth = (offset / (rays @ normal)).astype(np.float32)
    uv = rng.uniform([5, 5], [630, 470], size=(2000, 2))
    z = offset / (CAMERA.unproject(uv) @ normal)
    T = SE3.exp(rng.normal(size=6))
    xyz = T.inverse() @ (CAMERA.unproject(uv, z) / UNIT)
    return depth, Observations(T, uv, xyz, CAMERA, np.full(len(uv), 5))


def test_perfect_data_gives_the_exact_scale() -> None:
    depth, seen = perfect_view()
    ratios = z_ratios(depth, seen)
    # Between pixels too: inverse depth is linear on a plane.
    assert np.abs(ratios / UNIT - 1).max() < 1e-5
    estimate = summarise("depth", ratios)
    assert abs(estimate.factor / UNIT - 1) < 5e-4
    assert estimate.count > 1500
    assert estimate.spread < 1e-3


def test_dividing_by_range_would_be_biased() -> None:
    # The defect of a peer tool: sensor z-depth over Euclidean distance.
    depth, seen = perfect_view()
    good = z_ratios(depth, seen)
    p = seen.points_cam
    over_range = np.median(
        depth[np.rint(seen.uv[:, 1]).astype(int), np.rint(seen.uv[:, 0]).astype(int)]
        / np.linalg.norm(p, axis=1)
    )
    assert over_range / UNIT - 1 < -0.02
    assert abs(np.median(good) / UNIT - 1) < 5e-4


def test_holes_edges_and_bad_points_are_left_out() -> None:
    depth, seen = perfect_view()
    depth = depth.copy()
    depth[::7] = 0
    depth[:, 300:] *= 3  # a depth edge at column 300, and nonsense right of it is far but flat
    left = seen.uv[:, 0] < 295
    part = Observations(
        seen.T_cam_world, seen.uv[left], seen.xyz[left], CAMERA, seen.track_length[left]
    )
    ratios = z_ratios(depth, part)
    assert 100 < len(ratios) < left.sum()
    assert np.abs(ratios / UNIT - 1).max() < 2e-3
    edge = np.abs(seen.uv[:, 0] - 299.5) < 1.0
    at_edge = Observations(
        seen.T_cam_world, seen.uv[edge], seen.xyz[edge], CAMERA, seen.track_length[edge]
    )
    assert len(z_ratios(depth, at_edge)) == 0


def test_short_tracks_and_large_residuals_are_left_out() -> None:
    depth, seen = perfect_view()
    short = Observations(seen.T_cam_world, seen.uv, seen.xyz, CAMERA, np.full(len(seen.uv), 2))
    assert len(z_ratios(depth, short)) == 0
    moved = Observations(seen.T_cam_world, seen.uv + 5, seen.xyz, CAMERA, seen.track_length)
    assert len(z_ratios(depth, moved)) == 0


def test_summary_is_robust_and_counts_images_not_points() -> None:
    rng = np.random.default_rng(1)
    groups = np.repeat(np.arange(20), 100)
    per_image = rng.normal(0, 0.01, 20)[groups]
    ratios = 2.0 * (1 + per_image)
    ratios[::10] = 7.0
    estimate = summarise("depth", ratios, groups=groups)
    assert estimate.factor == pytest.approx(2.0, rel=0.01)
    assert estimate.standard_error > 5e-4  # 2000 points, but 20 independent errors


def test_a_hole_among_the_sixteen_pixels_around_leaves_a_point_out() -> None:
    depth, seen = perfect_view()
    one = Observations(seen.T_cam_world, seen.uv[:1], seen.xyz[:1], CAMERA, seen.track_length[:1])
    u, v = np.floor(seen.uv[0]).astype(int)
    assert len(z_ratios(depth, one)) == 1
    for dv in range(-2, 4):
        for du in range(-2, 4):
            holed = depth.copy()
            holed[v + dv, u + du] = 0
            around = -1 <= dv <= 2 and -1 <= du <= 2
            assert len(z_ratios(holed, one)) == (0 if around else 1), (du, dv)
