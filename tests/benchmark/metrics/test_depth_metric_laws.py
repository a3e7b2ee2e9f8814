"""What holds for depth metrics whatever the depths are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from benchmark.metrics import NAMES, DepthMetrics, Errors, Missing, depth_errors, image_errors, rmse
from benchmark.metrics.depth.tally import Tally, tally

METRES = st.floats(0.0625, 16, width=32)
ANYTHING = st.one_of(METRES, st.sampled_from([0.0, -0.5, np.nan, np.inf, -np.inf]))


@st.composite
def depths(draw: st.DrawFn, holes: bool = True) -> tuple[np.ndarray, np.ndarray]:
    n = draw(st.integers(1, 60))
    pred = draw(hnp.arrays(np.float32, n, elements=ANYTHING if holes else METRES))
    return pred, draw(hnp.arrays(np.float32, n, elements=METRES))


def close(one: Errors, two: Errors, rel: float = 1e-12) -> None:
    a, b = one.as_dict(), two.as_dict()
    assert list(a.values()) == pytest.approx(list(b.values()), rel=rel, nan_ok=True), (a, b)


@given(depths())
def test_bounds(pair: tuple[np.ndarray, np.ndarray]) -> None:
    found = depth_errors(*pair)
    assert 0 <= found.d105 <= found.d110 <= found.d125 <= found.coverage <= 1
    assert found.mae <= found.rmse * (1 + 1e-12)
    assert found.rel >= 0
    # A hole costs no more than relative error 1; leaving all of them out cannot make it worse
    # than the share that is left.
    if found.n_answered:
        expected = found.rel_answered * found.coverage + (1 - found.coverage)
        assert found.rel == pytest.approx(expected, rel=1e-9)
        assert found.d110 == pytest.approx(found.d110_answered * found.coverage)


@given(depths(), st.integers(-4, 4))
def test_another_unit(pair: tuple[np.ndarray, np.ndarray], power: int) -> None:
    """Powers of two change no digit, so that not even a threshold may flip."""
    pred, true = pair
    factor = np.float32(2.0**power)
    one, two = depth_errors(pred, true), depth_errors(pred * factor, true * factor)
    for name in ("rel", "d105", "d110", "d125", "coverage"):
        assert getattr(one, name) == getattr(two, name)
    assert two.rmse == pytest.approx(one.rmse * float(factor), rel=1e-12)
    assert two.mae == pytest.approx(one.mae * float(factor), rel=1e-12)


@pytest.mark.slow
@given(depths(holes=False))
def test_thresholds_do_not_tell_prediction_from_truth(pair: tuple[np.ndarray, np.ndarray]) -> None:
    one, two = depth_errors(*pair), depth_errors(pair[1], pair[0])
    assert (one.d105, one.d110, one.d125) == (two.d105, two.d110, two.d125)
    assert one.rmse == pytest.approx(two.rmse, rel=1e-12)


@given(depths(), st.randoms(use_true_random=False))
def test_order_of_pixels(pair: tuple[np.ndarray, np.ndarray], random: object) -> None:
    order = np.arange(len(pair[0]))
    random.shuffle(order)  # type: ignore[attr-defined]
    close(depth_errors(*pair), depth_errors(pair[0][order], pair[1][order]))


@given(depths())
def test_truth_is_perfect(pair: tuple[np.ndarray, np.ndarray]) -> None:
    found = depth_errors(pair[1], pair[1])
    assert (found.rmse, found.rel, found.mae, found.d105, found.coverage) == (0, 0, 0, 1, 1)


@given(depths())
def test_without_holes_the_way_to_count_them_is_all_one(
    pair: tuple[np.ndarray, np.ndarray],
) -> None:
    pred, true = pair
    there = (pred > 0) & np.isfinite(pred)
    assume(there.any())
    close(
        depth_errors(pred[there], true[there]),
        depth_errors(pred[there], true[there], missing=Missing.AS_GIVEN),
        rel=0,
    )
    assert rmse(pred, true, missing=Missing.LEFT_OUT) == pytest.approx(
        depth_errors(pred, true).rmse_answered, rel=1e-12
    )


@pytest.mark.slow
@given(depths(), st.data())
def test_cells_add_up(pair: tuple[np.ndarray, np.ndarray], data: st.DataObject) -> None:
    pred, true = pair
    cell = data.draw(hnp.arrays(np.intp, len(pred), elements=st.integers(0, 4)))
    cells = tally(pred, true, cell, 5)
    for wanted in ([0], [1, 3], [0, 1, 2, 3, 4]):
        within = np.isin(cell, wanted)
        close(cells.of(np.array(wanted)), depth_errors(pred[within], true[within]))


@given(depths(), st.integers(0, 60))
def test_tallies_of_parts_add_up(pair: tuple[np.ndarray, np.ndarray], at: int) -> None:
    pred, true = pair

    def of(part: slice) -> Tally:
        return tally(pred[part], true[part], np.zeros(len(pred[part]), np.intp), 1)

    close((of(np.s_[:at]) + of(np.s_[at:])).of(slice(None)), depth_errors(pred, true))


@settings(max_examples=50)
@given(st.lists(depths(), min_size=1, max_size=5), st.integers(0, 5))
def test_merging_is_one_pass(images: list[tuple[np.ndarray, np.ndarray]], at: int) -> None:
    whole, first, second = DepthMetrics(), DepthMetrics(), DepthMetrics()
    for i, (pred, true) in enumerate(images):
        for metrics in (whole, first if i < at else second):
            metrics.update(pred[None], true[None])
    first.merge(second)
    assert first.images == whole.images == len(images)
    a, b = first.compute(), whole.compute()
    assert list(a.values()) == pytest.approx(list(b.values()), rel=1e-12, nan_ok=True)
    errors = [depth_errors(*image) for image in images]
    for name in NAMES:
        mean = np.mean([getattr(e, name) for e in errors])
        assert a[name] == pytest.approx(mean, rel=1e-12)


@settings(max_examples=50)
@given(depths(), st.sampled_from([Missing.COUNTED, Missing.AS_GIVEN]))
def test_torch_and_numpy(pair: tuple[np.ndarray, np.ndarray], missing: Missing) -> None:
    torch = pytest.importorskip("torch")

    pred, true = pair
    tensors = [torch.from_numpy(np.ascontiguousarray(a))[None] for a in (pred, true)]
    found = image_errors(*tensors, missing=missing)
    for name, value in depth_errors(pred, true, missing=missing).as_dict().items():
        np.testing.assert_allclose(found[name].item(), value, rtol=1e-13, err_msg=name)
