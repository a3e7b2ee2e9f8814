"""Scoring of frames against figures worked out by hand, and protocols against each other."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from frames_to_score import (
    FOUR,
    SPECULAR,
    TRANSPARENT,
    by_name,
    frame,
    random_depths,
)

from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.metrics import NAMES, Missing, depth_errors, resize_nearest
from benchmark.metrics.protocols import (
    Grid,
    Protocol,
    Subset,
    get_protocol,
    protocols,
    score_depth,
    score_frame,
    score_sensor,
)
from std_toolkit.errors import ToolkitError

STRICT, PAPER = get_protocol(), get_protocol("paper")
ALL_PROTOCOLS = ("strict", "paper", "cleargrasp", "transcg")
NATIVE = Protocol(
    name="native",
    about="",
    grids=(Grid("native", None),),
    subsets=STRICT.subsets,
    missing=Missing.COUNTED,
)


def quarters(height: int = 8, width: int = 8) -> np.ndarray:
    """Four objects, each a quarter of the image: raw, diffuse, transparent, specular."""
    mask = np.zeros((height, width), np.uint8)
    mask[: height // 2, width // 2 :] = 1
    mask[height // 2 :, : width // 2] = 2
    mask[height // 2 :, width // 2 :] = 3
    return mask


def test_materials_by_hand() -> None:
    true = np.ones((8, 8), np.float32)
    mask = quarters()
    pred = true + np.array([0.0, 0.125, 0.25, 0.5], np.float32)[mask]
    found = by_name(score_frame(pred, frame(true, mask), NATIVE))
    mae = {subset: row.errors.mae for (_, subset), row in found.items()}
    assert mae["all"] == 0.21875
    assert mae["diffuse"] == 0.0625
    assert mae["specular+transparent"] == 0.375
    assert (mae["transparent"], mae["specular"]) == (0.25, 0.5)
    rmse = found["native", "specular+transparent"].errors.rmse
    assert rmse == pytest.approx(math.sqrt((0.0625 + 0.25) / 2), rel=1e-12)
    assert found["native", "all"].errors.d125 == 0.5
    assert found["native", "all"].errors.n_pixels == 64


def test_rows_are_those_of_the_pure_functions() -> None:
    """Grids, subsets and one-pass sums against resizing everything and masking it."""
    pred, true = random_depths((70, 50))
    mask = np.random.default_rng(7).choice([0, 1, 2, 3, BACKGROUND], true.shape).astype(np.uint8)
    for protocol in (STRICT, PAPER):
        found = by_name(score_frame(pred, frame(true, mask), protocol))
        for grid in protocol.grids:
            p, g, m = pred, true, mask
            for size in grid.steps((70, 50)):
                p, g, m = (resize_nearest(a, size) for a in (p, g, m))
            for subset in protocol.subsets:
                if subset.edges:
                    continue
                ids = [i.mask_id for i in FOUR if i.material in subset.materials]
                expected = depth_errors(p, g, np.isin(m, ids), missing=protocol.missing)
                row = found[grid.name, subset.name].errors
                assert list(row.as_dict().values()) == pytest.approx(
                    list(expected.as_dict().values()), rel=1e-12, nan_ok=True
                ), (grid, subset)
                assert row.n_pixels > 500


def test_a_prediction_of_another_size_is_resized_to_each_grid() -> None:
    _, true = random_depths((320, 180))
    small = (resize_nearest(true, (224, 224)) * np.float32(1.02)).astype(np.float32)
    at = frame(true)
    for protocol in (STRICT, PAPER):
        rows = score_frame(small, at, protocol)
        for row in rows:
            grid = next(g for g in protocol.grids if g.name == row.grid)
            if row.subset != "all":
                continue
            p, g = small, true
            for size in grid.steps((320, 180)):
                p, g = resize_nearest(p, size), resize_nearest(g, size)
            expected = depth_errors(p, g, missing=protocol.missing)
            assert row.errors.rmse == pytest.approx(expected.rmse, rel=1e-12)


@pytest.mark.parametrize("factor", [0.97, 1.07, 1.2, 1.5])
@pytest.mark.parametrize("size", [(224, 224), (640, 360), (97, 61)])
def test_a_constant_factor_is_the_same_everywhere(factor: float, size: tuple[int, int]) -> None:
    """Relative figures do not depend on which pixels are compared: all protocols agree."""
    true = random_depths(size)[1]
    worst = max(factor, 1 / factor)
    transparent = (Instance(0, 6, TRANSPARENT),)
    for name in ALL_PROTOCOLS:
        at = frame(true, np.zeros(true.shape), transparent)
        for row in score_frame(true * np.float32(factor), at, get_protocol(name)):
            if row.errors.n_pixels == 0:
                assert row.subset in ("specular", "diffuse")
                continue
            assert row.errors.rel == pytest.approx(abs(factor - 1), rel=1e-5)
            expected = [float(worst < t) for t in (1.05, 1.10, 1.25)]
            assert [row.errors.d105, row.errors.d110, row.errors.d125] == expected
            assert row.errors.coverage == 1


def test_strict_and_paper_agree_on_transposed_images() -> None:
    """The paper's grid is the transposed one: of a square image, so are the pixels."""
    pred, true = random_depths((224, 224))
    pred = np.where(np.isfinite(pred) & (pred > 0), pred, np.float32(0))
    strict = score_frame(pred, frame(true), STRICT)
    paper = score_frame(pred.T, frame(true.T), PAPER)
    one, two = by_name(strict)["h126w224", "all"], by_name(paper)["h224w126", "all"]
    assert list(one.errors.as_dict().values()) == pytest.approx(
        list(two.errors.as_dict().values()), rel=1e-12
    )
    # And of an image that is its own transposed one, both see the same.
    both, same = pred + pred.T, true + true.T
    one = score_frame(both, frame(same), STRICT)[0]
    two = score_frame(both, frame(same), PAPER)[0]
    assert one.errors.rmse == pytest.approx(two.errors.rmse, rel=1e-12)
    assert one.errors.d105 == two.errors.d105


def test_a_hole_is_a_depth_of_nothing_for_both() -> None:
    """The released evaluation counts a prediction of 0 as an error of the whole depth, too."""
    pred, true = random_depths((224, 224))
    holes = np.where(np.isfinite(pred) & (pred > 0), pred, np.float32(0))
    counted = replace(PAPER, missing=Missing.COUNTED)
    assert score_frame(holes, frame(true), PAPER) == score_frame(holes, frame(true), counted)
    assert score_frame(pred, frame(true), counted) == score_frame(holes, frame(true), counted)


def test_a_method_that_failed_misses_every_pixel() -> None:
    true = np.full((20, 30), 0.5, np.float32)
    for name in ALL_PROTOCOLS:
        at = frame(true, np.zeros(true.shape), (Instance(0, 6, TRANSPARENT),))
        first = score_frame(None, at, get_protocol(name))[0].errors
        assert (first.coverage, first.d125, first.rel, first.rmse) == (0, 0, 1, 0.5)
        assert math.isnan(first.rmse_answered)


def test_the_sensor_is_a_row_to_beat() -> None:
    pred, true = random_depths((64, 48))
    at = frame(true, raw=pred)
    for protocol in (STRICT, PAPER):
        assert repr(score_sensor(at, protocol)) == repr(score_frame(pred, at, protocol))


def test_edges_are_those_of_the_full_ground_truth() -> None:
    """Two objects side by side, 400 wide: a band of two columns on each side of their border."""
    true = np.full((40, 400), 1.0, np.float32)
    mask = np.zeros((40, 400), np.uint8)
    mask[:, 200:] = 3
    pred = true.copy()
    pred[:, 198:202] = 2.0
    found = by_name(score_frame(pred, frame(true, mask), NATIVE))
    edges = found["native", "edges"].errors
    assert (edges.n_pixels, edges.mae, edges.d125) == (4 * 40, 1.0, 0.0)
    hard = found["native", "specular+transparent edges"].errors
    assert (hard.n_pixels, hard.mae) == (2 * 40, 1.0)
    assert found["native", "all"].errors.mae == pytest.approx(4 / 400)
    # A coarse grid shows the same band, not one of its own pixels' width.
    coarse = by_name(score_frame(pred, frame(true, mask), STRICT))["h126w224", "edges"]
    assert coarse.errors.mae == 1
    assert coarse.errors.n_pixels == pytest.approx(4 / 400 * 224 * 126, rel=0.5)


def test_distractors_belong_to_all() -> None:
    true, mask = np.ones((8, 8), np.float32), quarters()
    others = tuple(replace(i, class_id=0) for i in FOUR)
    assert score_frame(true, frame(true, mask, others), NATIVE)[0].errors.n_pixels == 64


def test_background_is_never_compared() -> None:
    true = np.ones((8, 8), np.float32)
    mask = quarters()
    mask[0] = BACKGROUND
    pred = true.copy()
    pred[0] = 50
    for protocol in (NATIVE, PAPER):
        found = score_frame(pred, frame(true, mask), protocol)[0].errors
        assert found.rmse == 0
    assert score_frame(pred, frame(true, mask), NATIVE)[0].errors.n_pixels == 56


def test_every_frame_has_every_row() -> None:
    """Rows of frames without objects, ground truth or materials are there, and empty."""
    true = np.ones((8, 8), np.float32)
    for at in (
        frame(true, np.full((8, 8), BACKGROUND), ()),
        frame(np.zeros((8, 8)), quarters()),
        frame(true, quarters()),
    ):
        rows = [r for r in score_frame(true, at, STRICT) if not r.subset.startswith("depth:")]
        assert [(r.grid, r.subset) for r in rows] == [
            (g.name, s.name) for g in STRICT.grids for s in STRICT.subsets
        ]
    empty = score_frame(true, frame(np.zeros((8, 8)), quarters()), STRICT)
    assert all(r.errors.n_pixels == 0 and math.isnan(r.errors.rmse) for r in empty)


def test_ranges_of_depth_share_the_pixels_out() -> None:
    """Every pixel of the main subset is in one range: their sums are those of the subset."""
    true = np.linspace(0.31, 0.89, 64, dtype=np.float32).reshape(8, 8)
    pred = true * np.linspace(0.9, 1.2, 64, dtype=np.float32).reshape(8, 8)
    pred[3] = 0
    rows = score_frame(pred, frame(true, quarters()), STRICT)
    whole = rows[0].errors
    ranges = {r.subset: r.errors for r in rows if r.subset.startswith("depth:")}
    assert list(ranges) == [f"depth:{x / 10:.2f}-{(x + 1) / 10:.2f}" for x in range(3, 9)]
    for name in ("n_pixels", "n_answered"):
        assert sum(getattr(e, name) for e in ranges.values()) == getattr(whole, name)
    total = sum(e.rmse**2 * e.n_pixels for e in ranges.values())
    assert math.isclose(total, whole.rmse**2 * whole.n_pixels, rel_tol=1e-12)


def test_categories() -> None:
    true, mask = np.ones((8, 8), np.float32), quarters()
    objects = (
        Instance(0, 6, SPECULAR),
        Instance(1, 6, TRANSPARENT),
        Instance(2, 1, SPECULAR, category="jug"),
        Instance(3, 0, SPECULAR),
    )
    pred = true + np.array([0.0, 0.5, 0.25, 1.0], np.float32)[mask]
    rows = score_frame(pred, frame(true, mask, objects), replace(NATIVE, per_category=True))
    mae = {r.subset: r.errors.mae for r in rows if r.subset.startswith("category:")}
    assert mae == {"category:jug": 0.25, "category:mug": 0.25, "category:other": 1.0}


def test_cleargrasp_compares_transparent_objects_alone() -> None:
    pred, true = random_depths((1280, 720))
    mask = quarters(720, 1280)
    row = score_frame(pred, frame(true, mask), get_protocol("cleargrasp"))[0]
    small = [resize_nearest(a, (256, 144)) for a in (pred, true, mask)]
    expected = depth_errors(small[0], small[1], small[2] == 2)
    assert (row.grid, row.subset) == ("h144w256", "transparent")
    assert row.errors.as_dict() == pytest.approx(expected.as_dict(), rel=1e-12)


def test_transcg_compares_depths_in_range_alone() -> None:
    true = np.full((240, 320), 1.0, np.float32)
    true[0], true[1], true[2], true[3] = 0.29, 1.51, 0.3, 1.5
    pred = true.copy()
    pred[:2] = 9
    mask = np.full(true.shape, 2)
    row = score_frame(pred, frame(true, mask), get_protocol("transcg"))[0]
    assert (row.grid, row.subset) == ("h240w320", "transparent")
    assert row.errors.n_pixels == 238 * 320
    assert row.errors.rmse == 0


def test_infinite_ground_truth_is_not_compared() -> None:
    true = np.ones((8, 8), np.float32)
    true[0, 0], true[0, 1] = np.inf, np.nan
    for name in ("strict", "paper", "transcg"):
        protocol = replace(get_protocol(name), grids=NATIVE.grids, subsets=(Subset("all"),))
        rows = score_depth(np.ones((8, 8)), true, quarters(), FOUR, protocol)
        assert rows[0].errors.n_pixels == 62


def test_rows_become_columns() -> None:
    true = np.ones((8, 8), np.float32)
    row = score_frame(true, frame(true), STRICT)[0].as_dict()
    assert list(row)[:4] == ["grid", "subset", "n_pixels", "n_answered"]
    assert {*NAMES, "coverage", "rmse_answered"} < set(row)
    assert all(isinstance(v, (str, int, float)) for v in row.values())


@pytest.mark.slow
def test_scoring_needs_no_torch() -> None:
    """Methods that learn nothing are scored where the training extra is not installed."""
    program = (
        "import sys; sys.modules['torch'] = None\n"
        "import numpy as np\n"
        "from benchmark.metrics import DepthMetrics\n"
        "from benchmark.metrics.protocols import get_protocol, score_depth\n"
        "import benchmark.evaluation.tasks.depth_results, benchmark.metrics.significance\n"
        "one = np.ones((4, 4), np.float32)\n"
        "score_depth(one, one, np.full((4, 4), 255, np.uint8), (), get_protocol())\n"
        "DepthMetrics().update(one, one)\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_names() -> None:
    assert set(protocols) >= set(ALL_PROTOCOLS)
    assert STRICT.name == "strict" and STRICT.view_size is None
    assert PAPER.view_size == (224, 224)
    assert PAPER.main == ("h224w126", "all")
    assert [s.materials for s in PAPER.subsets] == [
        set(Material),
        {Material.TRANSPARENT, Material.SPECULAR},
    ]
    for name in ALL_PROTOCOLS:
        assert get_protocol(name).name == name


def test_what_is_refused() -> None:
    true = np.ones((8, 8), np.float32)
    for bad in (np.ones((1, 8, 8)), np.ones((8, 8), np.uint16), np.ones((0, 8))):
        with pytest.raises(ToolkitError, match=r"scene/0000: restored depth must be one image"):
            score_frame(bad, frame(true), STRICT)
    with pytest.raises(ToolkitError, match="no plug-in with this name"):
        get_protocol("stirct")
    with pytest.raises(ToolkitError, match="is not a Protocol"):
        get_protocol("benchmark.metrics.protocols.score:score_frame")
    with pytest.raises(ToolkitError, match="each under a name of its own"):
        replace(STRICT, subsets=(Subset("all"), Subset("all")))
    with pytest.raises(ToolkitError, match="no way to count"):
        replace(STRICT, missing=Missing.LEFT_OUT)


def test_a_depth_range_holds_its_near_end_and_not_its_far_end() -> None:
    """What lies on an end counts once, in the range that begins there."""
    protocol = replace(NATIVE, depth_bins=(0.5, 0.75, 1.0))
    below = np.nextafter(np.float32([0.5, 0.75, 1.0]), np.float32(0))
    true = np.array([[0.5, 0.75, 1.0, *below]], np.float32)
    found = by_name(score_frame(true + np.float32(0.125), frame(true), protocol))
    counts = {subset: row.errors.n_pixels for (_, subset), row in found.items()}
    near, far = "depth:0.50-0.75", "depth:0.75-1.00"
    assert (counts[near], counts[far]) == (2, 2)
    for ends, (low, high) in {near: (0.5, 0.75), far: (0.75, 1.0)}.items():
        inside = (true >= low) & (true < high)
        rel = float((0.125 / true[inside]).mean())
        assert found["native", ends].errors.rel == pytest.approx(rel, rel=1e-6)


def test_an_end_of_a_depth_range_of_strict_is_the_same_number_in_the_data() -> None:
    """0.3 m of a float32 image lies in 0.30-0.40, although it is no binary number."""
    for end in STRICT.depth_bins[:-1]:
        true = np.full((4, 4), end, np.float32)
        found = [r.subset for r in score_frame(true, frame(true), STRICT) if "depth" in r.subset]
        assert found == [f"depth:{end:.2f}-{end + 0.1:.2f}"]
    last = np.full((4, 4), STRICT.depth_bins[-1], np.float32)
    assert not [r for r in score_frame(last, frame(last), STRICT) if "depth" in r.subset]


def test_both_ends_of_the_depths_compared_are_included() -> None:
    protocol = replace(NATIVE, depth_range=(0.5, 1.0))
    true = np.array([[0.5, 0.75, 1.0]], np.float32)
    outside = np.nextafter(true[:, [0, 2]], np.float32([[0, 2]]))
    true = np.concatenate([true, outside], axis=1)
    assert score_frame(true, frame(true), protocol)[0].errors.n_pixels == 3
