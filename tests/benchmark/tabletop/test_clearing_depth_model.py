"""The quick depth camera: labels in their shares, holes where no camera measures, seeded."""

import numpy as np
import pytest

from benchmark.data.frame import BACKGROUND
from benchmark.tabletop.depth_model import (
    HOLE,
    KINDS,
    LABELS,
    LEVELS,
    OTHER,
    SURFACE,
    degrade,
    draw_shares,
    load_depth_model,
    pixel_kinds,
    unmatched,
)
from std_toolkit.geometry.camera import Camera

CAMERA = Camera(424, 240, 301.0, 301.0, 211.5, 119.5)
MODEL = load_depth_model()
HERE = (slice(90, 150), slice(180, 260))


def _scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A table 0.7 m away and a flat object of 6 cm upon it."""
    behind = np.full((240, 424), 0.7, np.float32)
    depth, mask = behind.copy(), np.full((240, 424), BACKGROUND, np.uint8)
    depth[HERE], mask[HERE] = 0.64, 0
    return depth, mask, behind


def _measured(material: str, seed: int = 0, share: np.ndarray | None = None) -> np.ndarray:
    depth, mask, behind = _scene()
    shares = None if share is None else {0: share}
    rng = np.random.default_rng(seed)
    return degrade(depth, mask, behind, {0: material}, CAMERA, rng=rng, shares=shares)


def test_the_fitted_figures_are_shares_of_what_they_say():
    assert set(MODEL.kinds) == set(KINDS)
    for kind in MODEL.kinds.values():
        assert sum(kind.shares) == pytest.approx(1, abs=1e-3)
        assert len(kind.shares) == len(LABELS)
        assert len(kind.wrong_m) == len(LEVELS)
        assert kind.instances > 30
        assert np.all(np.diff(kind.wrong_m) >= 0)
    # What the sensor cannot see is what it is about.
    glass, paint = MODEL.kinds["transparent"], MODEL.kinds["diffuse"]
    assert glass.shares[HOLE] > 0.1 > 0.05 > paint.shares[HOLE]
    assert glass.shares[SURFACE] < 0.4 < 0.95 < paint.shares[SURFACE]
    assert glass.shares[OTHER] > 0.2
    # What it is not about: of a bare table nearly everything is measured.
    assert MODEL.kinds["table"].shares[SURFACE] > 0.95


def test_an_object_gets_the_shares_that_it_was_given():
    share = np.array([0.2, 0.3, 0.1, 0.4])
    made = _measured("transparent", share=share)[HERE]
    assert (made == 0).mean() == pytest.approx(0.4, abs=0.01)
    assert (np.abs(made - 0.7) < 0.012).mean() == pytest.approx(0.3, abs=0.04)
    assert (np.abs(made - 0.64) < 0.012).mean() == pytest.approx(0.2, abs=0.06)


def test_an_object_that_is_all_surface_is_where_it_is():
    made = _measured("diffuse", share=np.array([1.0, 0, 0, 0]))
    inner = made[95:145, 190:250]
    fitted = MODEL.kinds["diffuse"]
    assert np.median(inner) == pytest.approx(0.64 + fitted.bias_m, abs=1e-4)
    # Noise of the disparity, as depth at this distance.
    sigma = fitted.noise_px * 0.64**2 / (CAMERA.fx * 0.055)
    assert inner.std() == pytest.approx(sigma, rel=0.25)


def test_nothing_is_measured_where_the_right_camera_does_not_look():
    depth, _, _ = _scene()
    focal_baseline = CAMERA.fx * 0.055
    strip = unmatched(depth, focal_baseline)
    # At 0.7 m the right image is shifted by 23.65 pixels, and half a window is 5.
    assert strip[120, :29].all()
    assert not strip[120, 29:400].any()
    assert (_measured("diffuse")[strip] == 0).all()


def test_the_shadow_lies_to_the_left_of_what_is_near():
    depth, mask, behind = _scene()
    kinds, other = pixel_kinds(
        depth, mask, behind, {0: "diffuse"}, focal_baseline=4 * CAMERA.fx * 0.055
    )
    # At four times the baseline the object hides 8.9 pixels of the table from the right camera.
    row = kinds[120]
    hidden = np.flatnonzero(row == KINDS.index("shadow"))
    assert 7 <= len(hidden) <= 10
    assert hidden.min() >= 170 and hidden.max() <= 180
    edge = kinds[120] == KINDS.index("edge")
    assert edge[262] and not edge[270]
    assert other[120, 262] == pytest.approx(0.64)


def test_glass_makes_no_edge():
    depth, mask, behind = _scene()
    kinds, _ = pixel_kinds(depth, mask, behind, {0: "transparent"}, focal_baseline=16.6)
    assert set(np.unique(kinds)) == {KINDS.index("transparent"), KINDS.index("table")}


def test_the_same_seed_gives_the_same_depth():
    assert np.array_equal(_measured("specular", 3), _measured("specular", 3))
    assert not np.array_equal(_measured("specular", 3), _measured("specular", 4))


def test_drawn_shares_have_the_fitted_means():
    rng = np.random.default_rng(0)
    drawn = np.mean([draw_shares("specular", rng) for _ in range(4000)], axis=0)
    assert drawn == pytest.approx(MODEL.kinds["specular"].shares, abs=0.02)
