"""What each filling makes of surfaces that are known by formula."""

from __future__ import annotations

import numpy as np
import pytest
from filling_scenes import (
    CAMERA,
    FILLINGS,
    disc,
    grey,
    plane_depth,
    restored,
    two_walls,
    view_of,
)
from scipy.spatial import cKDTree

from benchmark.methods.depth.filling.colorization import spread_depth
from benchmark.methods.depth.filling.planes import grow_planes
from benchmark.methods.protocol import View
from std_toolkit.geometry.camera import Camera, pixel_rays

TABLE = plane_depth((0.1, 0.75, 0.65), 0.5)  # 0.47 to 1.2 m
HOLE = disc(60, 80, 20)


def errors(method: str, **settings: str) -> np.ndarray:
    """Relative errors in a hole in the table."""
    return np.abs(restored(method, view_of(TABLE, HOLE), **settings) / TABLE - 1)[HOLE]


# In the hole the depth lies up to 13 % from that of the rim; measured errors and a tenth more.
@pytest.mark.parametrize(
    ("method", "median", "worst"),
    [
        ("nearest", 0.022, 0.14),
        ("navier-stokes", 0.017, 0.095),
        ("telea", 0.025, 0.11),
        ("joint-bilateral", 0.024, 0.085),
        ("colorization", 0.005, 0.009),
        ("planes", 1e-6, 1e-6),
    ],
)
def test_a_tilted_plane_through_a_hole(method: str, median: float, worst: float) -> None:
    error = errors(method)
    assert np.median(error) < median
    assert error.max() < worst


def test_planes_are_exact_where_others_must_guess_up_to_the_border() -> None:
    hidden = np.zeros(TABLE.shape, dtype=bool)
    hidden[:, 120:] = True
    view = view_of(TABLE, hidden)
    assert np.abs(restored("planes", view) / TABLE - 1).max() < 1e-6
    assert np.abs(restored("nearest", view) / TABLE - 1).max() > 0.02


def test_planes_survive_noise_of_a_sensor() -> None:
    rng = np.random.default_rng(3)
    noisy = TABLE * (1 + rng.normal(0, 0.002, TABLE.shape))
    error = np.abs(restored("planes", view_of(noisy, HOLE)) / TABLE - 1)[HOLE]
    assert error.max() < 5e-4  # the mean of thousands of pixels, not that of a rim


def test_planes_through_a_lens_with_distortion() -> None:
    camera = Camera(160, 120, 180, 180, 80, 60, (-0.12, 0.03, 0.001, -0.001))
    depth = 0.5 / (pixel_rays(camera) @ np.array([0.1, 0.75, 0.65]))
    view = View(grey(), np.where(HOLE, 0, depth).astype(np.float32), camera)
    assert np.abs(restored("planes", view) / depth - 1)[HOLE].max() < 1e-6


def test_a_plane_is_not_continued_beyond_its_horizon() -> None:
    floor = plane_depth((0, 1, 0.02), 0.3)  # horizon near the middle of the image
    hidden = np.zeros(floor.shape, dtype=bool)
    hidden[:85] = True
    filled = restored("planes", view_of(np.where(floor > 0, floor, 0), hidden))
    assert filled.min() > 0
    assert filled.max() <= 2.001 * floor[85:].max()
    near = np.abs(filled / floor - 1)[80:85]
    assert near.max() < 1e-6


def test_a_small_plane_is_not_continued_far() -> None:
    rng = np.random.default_rng(0)
    hidden = np.ones(TABLE.shape, dtype=bool)
    hidden[50:70, 10:30] = False
    noisy = TABLE * (1 + rng.normal(0, 0.004, TABLE.shape))
    view = view_of(noisy, hidden)
    bold = restored("planes", view, certainty="1", least_cells="4")
    careful = restored("planes", view, certainty="0.01", least_cells="4")
    nearby = np.s_[45:50, 10:30]
    assert np.allclose(careful[nearby], TABLE[nearby], rtol=0.02)
    assert np.allclose(bold[nearby], careful[nearby], rtol=1e-6)
    # Far away the careful one keeps nearer to what was measured, 0.75 m and more.
    assert careful[110, 150] > bold[110, 150] + 0.05


def test_grown_planes_are_those_of_the_scene() -> None:
    depth, _ = two_walls()
    tilted = plane_depth((0.5, 0, 0.85), 0.55)
    scene = np.where(np.arange(CAMERA.width) < 80, tilted, depth)
    planes = grow_planes(scene, pixel_rays(CAMERA), cell_px=5, tolerance=0.006, least_cells=8)
    assert len(planes) == 2
    found = sorted((p.inverse_depth.tolist() for p in planes), key=lambda p: p[0])
    assert np.allclose(found[0], [0, 0, 1 / 1.5], atol=1e-6)
    assert np.allclose(found[1], np.array([0.5, 0, 0.85]) / 0.55, atol=1e-6)
    labels = sum(p.inliers.astype(int) for p in planes)
    assert labels.max() == 1  # no pixel is on two
    assert labels.mean() > 0.99


def test_noise_has_no_planes() -> None:
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.5, 1.5, TABLE.shape)
    assert not grow_planes(depth, pixel_rays(CAMERA), cell_px=5, tolerance=0.006, least_cells=8)


@pytest.mark.parametrize("method", ["joint-bilateral", "colorization", "planes"])
@pytest.mark.parametrize("column", [80, 100])  # the edge in the middle of the hole, and not
def test_an_edge_of_depth_is_kept_where_colour_has_one(method: str, column: int) -> None:
    depth, color = two_walls()
    filled = restored(method, view_of(depth, disc(60, column, 35), color))
    wrong = np.abs(filled - depth) > 0.05
    assert not wrong[:, np.abs(np.arange(CAMERA.width) - 79.5) > 3].any()
    assert wrong.mean() < 0.005


@pytest.mark.parametrize("method", ["nearest", "navier-stokes", "telea"])
def test_methods_blind_to_colour_do_not_see_it(method: str) -> None:
    depth, color = two_walls()
    hidden = disc(60, 100, 35)  # the near wall reaches into it from the left
    filled = restored(method, view_of(depth, hidden, color))
    assert np.array_equal(filled, restored(method, view_of(depth, hidden)))
    assert (np.abs(filled - depth) > 0.05)[hidden].mean() > 0.02


def test_nearest_is_the_nearest() -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.4, 2, TABLE.shape).astype(np.float32)
    hidden = rng.uniform(size=TABLE.shape) < 0.9
    filled = restored("nearest", view_of(depth, hidden))
    seen = np.argwhere(~hidden)
    distance, _ = cKDTree(seen).query(np.argwhere(hidden))
    for pixel, least in zip(np.argwhere(hidden)[::50], distance[::50], strict=True):
        away = np.hypot(*(seen - pixel).T)
        candidates = depth[tuple(seen[away < least + 1e-9].T)]
        assert filled[tuple(pixel)] in candidates


def test_inpainting_keeps_the_precision_of_float() -> None:
    # 8 bits over this range would be steps of 2.5 mm.
    slope = 1 + 0.004 * np.arange(CAMERA.width) / CAMERA.width + np.zeros(TABLE.shape)
    corner = np.zeros(TABLE.shape)
    corner[:2, :2] = 0.64
    depth = slope + corner
    hidden = disc(60, 80, 10)
    for method in ("navier-stokes", "telea"):
        filled = restored(method, view_of(depth, hidden))
        assert np.abs(filled - depth)[hidden].max() < 0.0006
        assert len(np.unique(filled[hidden])) > 100


def test_colorization_solves_its_equations() -> None:
    rng = np.random.default_rng(5)
    depth = rng.uniform(0.5, 1.5, (12, 9))
    color = rng.integers(0, 256, (12, 9, 3), dtype=np.uint8)
    missing = rng.uniform(size=depth.shape) < 0.6
    found = spread_depth(color, np.where(missing, 0, depth), missing)
    brightness = np.round(color @ [0.299, 0.587, 0.114]) / 255
    for v, u in np.argwhere(missing):
        around = [
            (y, x)
            for y in range(max(v - 1, 0), min(v + 2, 12))
            for x in range(max(u - 1, 0), min(u + 2, 9))
            if (y, x) != (v, u)
        ]
        values = np.array([brightness[p] for p in around])
        unlike = (values - brightness[v, u]) ** 2
        variance = np.var([*values, brightness[v, u]])
        spread = max(0.6 * variance, unlike.min() / np.log(100), 2e-6)
        weights = np.exp(-unlike / spread)
        mean = (weights * [found[p] for p in around]).sum() / weights.sum()
        assert found[v, u] == pytest.approx(mean, abs=1e-9)


@pytest.mark.parametrize("method", FILLINGS)
def test_colour_alone_makes_no_depth(method: str) -> None:
    rng = np.random.default_rng(2)
    stripes = np.repeat(rng.integers(0, 256, (1, CAMERA.width, 3)), CAMERA.height, axis=0)
    flat = np.full(TABLE.shape, 0.75)
    filled = restored(method, view_of(flat, HOLE, stripes.astype(np.uint8)))
    assert np.allclose(filled, 0.75, rtol=1e-5)
