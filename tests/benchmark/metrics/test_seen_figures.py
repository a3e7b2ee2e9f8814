"""Harm, trust and cut holes: figures worked out by hand, and what would make them lie."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmark.metrics.depth.depth_metrics import depth_errors, image_errors
from benchmark.metrics.depth.harm import harm, harm_by_region, right_pixels
from benchmark.metrics.depth.holes import KINDS, cut_holes, right_without_truth
from benchmark.metrics.depth.trust import REGIONS, selective_errors, trust_figures
from std_toolkit.errors import ToolkitError


def test_within_is_the_larger_of_3_mm_and_1_percent() -> None:
    true = np.array([0.1, 0.1, 1.0, 1.0, 1.0])
    pred = np.array([0.1029, 0.1031, 1.0099, 0.9899, 0.0])
    found = depth_errors(pred, true)
    assert found.within == 2 / 5
    assert found.within_answered == 2 / 4


def test_within_is_the_same_in_torch() -> None:
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(0)
    true = rng.uniform(0.1, 2, (3, 200)).astype(np.float32)
    pred = (true * rng.normal(1, 0.02, true.shape)).astype(np.float32)
    batch = image_errors(torch.from_numpy(pred), torch.from_numpy(true))
    each = [depth_errors(p, t).within for p, t in zip(pred, true, strict=True)]
    assert batch["within"].tolist() == pytest.approx(each, abs=1e-12)
    assert 0 < min(each) < max(each) < 1


def test_harm_counts_what_was_right_alone() -> None:
    true = np.full(6, 0.5)
    sensor = np.array([0.501, 0.504, 0.506, 0.0, 0.499, 0.499])  # the third was wrong before
    found = np.array([0.5105, 0.5095, 0.9, 0.9, 0.0, np.nan])
    assert right_pixels(sensor, true).tolist() == [True, True, False, False, True, True]
    # 10.5 mm is more than twice 5 mm, 9.5 mm is not; no answer harms.
    assert harm(found, sensor, true) == 3 / 4
    assert harm(sensor, sensor, true) == 0
    assert math.isnan(harm(found, 0 * sensor, true))


def test_harm_is_empty_where_the_truth_is_the_sensor() -> None:
    rng = np.random.default_rng(0)
    true = np.full((40, 60), 0.5)
    sensor = true + rng.normal(0, 0.001, true.shape)
    objects = np.zeros(true.shape, bool)
    objects[10:20, 10:20] = True
    mixed = np.where(objects, true, sensor)  # as TransCG files it: objects alone are rendered
    found = harm_by_region(sensor + 0.02, sensor, mixed, np.zeros_like(objects), objects)
    assert found["harm_opaque"] == 1
    assert math.isnan(found["harm_background"])
    assert math.isnan(found["harm_band"])  # no glass at all
    # A sensor and a truth in whole millimetres agree in many pixels, and are two things still.
    whole = np.round(sensor, 3)
    assert ((np.abs(whole - true) < 1e-4).mean()) > 0.3
    assert harm(whole + 0.02, whole, true) == 1


def test_the_band_is_around_glass_and_not_on_it() -> None:
    true = np.full((50, 200), 0.5)
    sensor = true + 0.001
    clear = np.zeros(true.shape, bool)
    clear[20:30, 90:110] = True
    near = np.zeros_like(clear)
    near[20:30, 85:115] = True
    swollen = np.where(near, 0.45, sensor)
    found = harm_by_region(swollen, sensor, true, clear, clear)
    assert math.isnan(found["harm_opaque"])
    assert found["harm_background"] == pytest.approx(100 / (50 * 200 - 200))
    # The band of 5 px holds all that is swollen beside the glass.
    assert found["harm_band"] > 4 * found["harm_background"]
    on_glass = np.where(clear, 0.1, sensor)
    assert harm_by_region(on_glass, sensor, true, clear, clear)["harm_background"] == 0
    with pytest.raises(ToolkitError, match="one shape"):
        harm(true, sensor[:1], true)


def test_selective_errors_do_not_depend_on_the_order_of_equals() -> None:
    error = np.arange(100.0)
    for order in (error, error[::-1]):
        same = selective_errors(order, np.ones(100))
        assert same["selective_50"] == same["selective_90"] == pytest.approx(error.mean())
    right, wrong = (selective_errors(error, s) for s in (error, -error))
    assert right["selective_50"] == pytest.approx(24.5)
    assert right["selective_area"] < same["selective_area"] < wrong["selective_area"]
    assert all(math.isnan(v) for v in selective_errors(error[:0], error[:0]).values())


def test_calibrated_spreads_cover_as_they_say() -> None:
    rng = np.random.default_rng(1)
    spread = rng.uniform(0.002, 0.02, (200, 200))
    true = np.full(spread.shape, 0.7)
    found = true + spread * rng.normal(size=spread.shape)
    found[:20] = 0  # no answer: in no coverage, last in trust
    regions = {name: np.ones(spread.shape, bool) for name in REGIONS}
    figures = trust_figures(found, spread, true, regions)
    assert figures["spread1_glass"] == pytest.approx(0.683, abs=0.01)
    assert figures["spread2_metal"] == pytest.approx(0.954, abs=0.01)
    assert figures["selective_50"] < figures["selective_75"] < figures["selective_90"]
    bold = trust_figures(found, spread / 3, true, regions)
    assert bold["spread1_opaque"] < 0.4


def table(height: int = 180, width: int = 240) -> np.ndarray:
    rows = np.linspace(0.9, 0.5, height, dtype=np.float32)[:, None]
    rng = np.random.default_rng(0)
    return (np.tile(rows, (1, width)) + rng.normal(0, 5e-4, (height, width))).astype(np.float32)


def test_holes_are_cut_where_depth_was_right_by_their_seed() -> None:
    depth = table()
    glass = np.zeros(depth.shape, bool)
    glass[60:100, 100:140] = True
    depth[20:30, 20:40] = 0
    cut = cut_holes(depth, "frame", avoid=glass)
    assert cut is not None
    gone = (cut.cut == 0) & (depth > 0)
    assert set(cut.removed) == set(KINDS)
    assert all(part.sum() >= 100 for part in cut.removed.values())
    assert sum(part.sum() for part in cut.removed.values()) == gone.sum()  # none twice
    assert 0.03 < gone.mean() < 0.5
    assert not gone[glass].any()
    again, other, late = (
        cut_holes(depth, key, avoid=glass, seed=seed)
        for key, seed in (("frame", 0), ("other", 0), ("frame", 1))
    )
    assert np.array_equal(again.cut, cut.cut)
    assert not np.array_equal(other.cut, cut.cut)
    assert not np.array_equal(late.cut, cut.cut)


def test_an_object_in_a_hole_is_an_error_and_no_answer_costs_the_depth() -> None:
    depth = table()
    cut = cut_holes(depth, "frame")
    assert cut.errors(depth)["holes"] == 0
    raised = np.where(cut.cut > 0, cut.cut, depth - 0.06)
    found = cut.errors(raised)
    assert found["holes"] == pytest.approx(0.06, abs=1e-6)
    assert found["holes_d105"] == 0
    assert cut.errors(np.full_like(depth, np.nan))["holes"] > 0.4
    # Each kind counts alike: a band is much larger than the ellipses.
    ellipses = np.where(cut.removed["ellipses"], depth - 0.06, depth)
    found = cut.errors(ellipses)
    assert found["holes"] == pytest.approx(0.02, abs=1e-6)
    assert found["holes_ellipses"] == pytest.approx(0.06, abs=1e-6)
    assert found["holes_band"] == found["holes_patches"] == 0


def test_without_truth_steps_and_the_far_wall_are_not_right() -> None:
    depth = table()
    depth[:, 120:] += 0.3
    depth[:60] = 2.5
    right = right_without_truth(depth)
    assert not right[:60].any()
    assert not right[:, 118:122].any()
    assert right[70:, 10:110].all()
    assert cut_holes(np.full((90, 120), 3.0, np.float32), "far") is None
    assert cut_holes(np.zeros((90, 120), np.float32), "empty") is None


def test_truth_tells_what_was_right() -> None:
    depth = table()
    true = depth.copy()
    true[:, 120:] = 0.3  # the sensor is wrong there
    cut = cut_holes(depth, "frame", true=true)
    assert not cut.right[:, 120:].any()
    true[:] = 0  # nobody knows: its own smoothness decides
    assert np.array_equal(cut_holes(depth, "frame", true=true).right, right_without_truth(depth))
