"""Glass and metal fused from several views: the hull, answers, wrong masks, few views, speed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmark.restoring.view_fusion import FusionSettings, ViewFusion
from benchmark.restoring.visual_hull import HullSettings, evidence, hull_of
from std_toolkit.geometry import SE3
from std_toolkit.settings import override
from tests.benchmark.restoring.view_cases import Seen, errors, seen_from_around


def fused_errors(scene: list[Seen]) -> np.ndarray:
    """Errors at glass and metal after the fusion; all else must be as it was."""
    fusion = ViewFusion([seen.view for seen in scene])
    found = []
    for seen in scene:
        fused = fusion.fuse(seen.view)
        same = ~fused.fused
        assert not (fused.fused & ~seen.view.mask).any()
        assert np.array_equal(fused.depth[same], seen.view.depth[same])
        assert np.array_equal(fused.spread[same], seen.view.spread[same])
        found.append(fused.depth)
    return errors(found, scene)


def single_errors(scene: list[Seen]) -> np.ndarray:
    return errors([seen.view.depth for seen in scene], scene)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def masks(scene: list[Seen], change: Callable[[int, np.ndarray], np.ndarray]) -> list[Seen]:
    """The scene with other masks; depth that a mask newly covers stays the sensor's."""
    found = []
    for index, seen in enumerate(scene):
        mask = change(index, seen.glass.astype(np.uint8))
        found.append(seen.but(clear=np.where(mask > 0, np.float32(0.93), np.float32(0.03))))
    return found


@pytest.fixture(scope="module")
def bottle() -> list[Seen]:
    return seen_from_around("bottle")


def test_a_bottle_is_restored_to_within_a_voxel_and_a_half(bottle):
    hull = hull_of([seen.view for seen in bottle])
    assert hull is not None and all(hull.counted) and 0.8 < hull.around <= 1
    found, single = fused_errors(bottle), single_errors(bottle)
    assert np.median(np.abs(found)) < 1.5 * hull.grid.edge < 0.003
    assert rms(found) < 0.2 * rms(single)


def test_the_spread_of_fused_depth_is_as_large_as_its_error(bottle):
    fusion = ViewFusion([seen.view for seen in bottle])
    fused = [fusion.fuse(seen.view) for seen in bottle]
    off = np.abs(errors([f.depth for f in fused], bottle))
    said = np.concatenate([f.spread[s.glass] for f, s in zip(fused, bottle, strict=True)])
    assert (off < said).mean() > 0.68 and (off < 2 * said).mean() > 0.95
    assert np.median(said) < 0.010  # 20 mm before


def test_a_network_that_sees_through_glass_is_corrected():
    """Answers 43 mm too far, of which the spread tells: as on the demo's bottle, from around."""
    scene = seen_from_around("bottle", bias=0.043, error=0.015)
    assert rms(single_errors(scene)) > 0.040
    assert rms(fused_errors(scene)) < 0.010


WRONG = (3, 11)  # views whose masks are wrong throughout


@pytest.mark.parametrize(
    ("change", "most"),
    [
        (lambda _, mask: cv2.erode(mask, np.ones((5, 5), np.uint8)), 0.014),
        (lambda _, mask: cv2.dilate(mask, np.ones((5, 5), np.uint8)), 0.012),
        (lambda index, mask: mask * (index not in WRONG), 0.005),
        (lambda index, mask: np.roll(mask, 60, axis=1) if index in WRONG else mask, 0.005),
    ],
    ids=["eroded by 2 px", "dilated by 2 px", "2 of 16 empty", "2 of 16 elsewhere"],
)
def test_wrong_masks_cost_little(bottle, change, most):
    """A right mask has 3 mm; 2 px are 7 mm on the bottle. All that was measured beside it stays."""
    scene = masks(bottle, change)
    fusion = ViewFusion([seen.view for seen in scene])
    assert [i for i, counts in enumerate(fusion.hull.counted) if not counts] in ([], [*WRONG])
    found, single, beside = [], [], []
    for index, seen in enumerate(scene):
        depth = fusion.fuse(seen.view).depth
        band = seen.view.mask & ~seen.glass
        beside.append(np.abs(depth - seen.true)[band])
        if index not in WRONG:
            inside = seen.view.mask & seen.glass
            found.append((depth - seen.true)[inside])
            single.append((seen.view.depth - seen.true)[inside])
    found, single, beside = (np.concatenate(e) for e in (found, single, beside))
    print(f"rms {1000 * rms(single):.1f} -> {1000 * rms(found):.1f} mm")
    assert rms(found) < most
    assert not beside.any()


def test_a_measured_box_that_all_masks_cover_stays(bottle):
    near = [(seen.true > 0) & (seen.true < np.median(seen.true) - 0.05) for seen in bottle]
    scene = masks(bottle, lambda index, mask: mask | near[index])
    assert min((seen.view.mask & ~seen.glass).sum() for seen in scene) > 100
    assert rms(fused_errors(scene)) < rms(single_errors(scene))
    fusion = ViewFusion([seen.view for seen in scene])
    for seen in scene:
        depth = fusion.fuse(seen.view).depth
        assert np.array_equal(depth[~seen.glass], seen.view.depth[~seen.glass])


def test_empty_masks_do_not_count_and_their_views_stay(bottle):
    scene = masks(bottle, lambda index, mask: mask * (index not in (3, 11)))
    views = [seen.view for seen in scene]
    fusion = ViewFusion(views)
    assert [i for i, counts in enumerate(fusion.hull.counted) if not counts] == [3, 11]
    assert np.array_equal(fusion.fuse(views[3]).depth, views[3].depth)


def test_poses_off_by_two_millimetres_cost_little(bottle):
    rng = np.random.default_rng(1)
    scene = []
    for seen in bottle:
        off = SE3.exp(np.concatenate([rng.normal(0, 0.002 / np.sqrt(3), 3), np.zeros(3)]))
        scene.append(seen.but(T_world_cam=seen.view.T_world_cam @ off))
    found = fused_errors(scene)
    print(f"rms {1000 * rms(found):.1f} mm, median {1000 * np.median(np.abs(found)):.1f}")
    assert rms(found) < 0.006


@pytest.mark.parametrize(
    "given",
    [
        {"error": 0.01},
        {"error": 0.02},
        {"error": 0.03},
        {"error": 0.02, "spread": 0.01},
        {"error": 0.005, "bias": 0.01},
        {"error": 0.02, "arc": 100},
    ],
    ids=str,
)
def test_a_bowl_is_no_worse_than_alone(given):
    """The hull fills the bowl: it is 60 mm off."""
    scene = seen_from_around("bowl", **given)
    hull = hull_of([seen.view for seen in scene])
    front = [hull.entry(seen.view, seen.glass).front for seen in scene]
    true = np.concatenate([seen.true[seen.glass] for seen in scene])
    assert np.median(true - np.concatenate(front)) > 0.05
    found, single = fused_errors(scene), single_errors(scene)
    print(f"rms {1000 * rms(single):.1f} -> {1000 * rms(found):.1f} mm")
    assert rms(found) < rms(single)
    assert np.median(np.abs(found)) < np.median(np.abs(single))


def test_two_views_are_no_worse_than_one(bottle):
    scene = [bottle[0], bottle[4]]
    assert hull_of([seen.view for seen in scene]) is not None
    assert rms(fused_errors(scene)) < rms(single_errors(scene))


@pytest.mark.parametrize("which", ["one view", "no glass"])
def test_nothing_changes_without_a_hull(bottle, which):
    scene = bottle[:1] if which == "one view" else masks(bottle[:4], lambda _, mask: 0 * mask)
    fusion = ViewFusion([seen.view for seen in scene])
    assert fusion.hull is None
    for seen in scene:
        fused = fusion.fuse(seen.view)
        assert np.array_equal(fused.depth, seen.view.depth) and not fused.fused.any()


def test_opaque_objects_in_front_take_nothing_away(bottle):
    """Something opaque stands before half of the object in every fourth view."""
    hull = hull_of([seen.view for seen in bottle])
    walled = []
    for index, seen in enumerate(bottle):
        if index % 4 == 0:  # its right half is hidden by something opaque at 0.3 m
            near = np.zeros(seen.glass.shape, bool)
            near[:, int(np.nonzero(seen.glass)[1].mean()) :] = True
            clear = np.where(near, np.float32(0.03), seen.view.clear)
            depth = np.where(near, np.float32(0.3), seen.view.depth)
            seen = seen.but(clear=clear, depth=depth, kept=seen.view.kept | near)
        walled.append(seen)
    again = hull_of([seen.view for seen in walled])
    both = [h.inside.sum() * h.grid.edge**3 for h in (hull, again)]
    assert both[1] == pytest.approx(both[0], rel=0.25)


def test_a_measurement_behind_a_voxel_speaks_against_it_most(bottle):
    view, opaque = bottle[0].view, ~bottle[0].glass & (bottle[0].true > 0)
    gain, hidden = evidence(view, 0.03)
    of_fill, _ = evidence(replace(view, kept=np.zeros(opaque.shape, bool)), 0.03)
    assert (gain[opaque] < of_fill[opaque]).all() and (of_fill[opaque] < 0).all()
    assert (gain[~opaque & bottle[0].glass] > 0).all()
    # It hides what lies farther behind it than its noise, 1 %.
    assert np.allclose(hidden[opaque], 1.01 * view.depth[opaque])
    assert (hidden[bottle[0].glass] > 1e6).all()


def test_views_beyond_the_largest_number_still_get_their_depth(bottle):
    """A view that is none of those fused gets the answer of the others."""
    fusion = ViewFusion([seen.view for seen in bottle[::2]])
    found = [fusion.fuse(seen.view).depth for seen in bottle[1::2]]
    assert rms(errors(found, bottle[1::2])) < 0.3 * rms(single_errors(bottle[1::2]))


def test_the_edge_of_a_voxel_is_a_limit(bottle):
    views = [seen.view for seen in bottle[::3]]
    with override(HullSettings(edge_mm=1000.0, cells=40)):
        coarse = hull_of(views)
    with override(HullSettings(edge_mm=4.0, cells=10)):
        fine = hull_of(views)
    assert max(coarse.grid.shape) in (40, 41) and fine.grid.edge == pytest.approx(0.004)
    with override(HullSettings(most_voxels=20_000)):
        assert np.prod(hull_of(views).grid.shape) < 30_000
    with override(FusionSettings(hull_share=1e3)):
        doubted = fused_errors(bottle[::3])
    assert rms(doubted) > 2 * rms(fused_errors(bottle[::3]))


@pytest.mark.slow
def test_36_views_of_640_x_480_take_less_than_a_second_each():
    small = seen_from_around("bottle", views=36)
    scene = []
    for seen in small:
        maps = {
            name: cv2.resize(getattr(seen.view, name), (640, 480), interpolation=cv2.INTER_NEAREST)
            for name in ("depth", "spread", "clear")
        }
        kept = maps["clear"] < 0.5
        camera = seen.view.camera.resized(640, 480)
        scene.append(replace(seen.view, camera=camera, kept=kept, **maps))
    ViewFusion(scene[:2]).fuse(scene[0])  # compiled
    began = time.process_time()
    fusion = ViewFusion(scene)
    for view in scene:
        assert fusion.fuse(view).fused.any()
    each = (time.process_time() - began) / len(scene)
    print(f"{each:.3f} s of processor time a frame")
    assert each < 1
