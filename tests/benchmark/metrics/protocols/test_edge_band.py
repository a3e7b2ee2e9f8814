"""Which pixels lie at an edge."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from benchmark.data.frame import BACKGROUND
from benchmark.metrics.protocols.score import STEP, band_width, edge_band


def slowly(true: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The definition, pixel by pixel."""
    height, width = mask.shape
    edge = np.zeros(mask.shape, bool)
    for y in range(height):
        for x in range(width):
            for v, u in ((y, x + 1), (y + 1, x)):
                if v >= height or u >= width:
                    continue
                near, far = sorted((true[y, x], true[v, u]))
                if mask[y, x] != mask[v, u] or (near > 0 and far > np.float32(STEP) * near):
                    edge[y, x] = edge[v, u] = True
    reach = band_width(width) - 1
    band = np.zeros(mask.shape, bool)
    for y, x in zip(*np.nonzero(edge), strict=True):
        band[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1] = True
    return band


@settings(max_examples=40, deadline=None)
@given(
    hnp.arrays(np.uint8, (6, 9), elements=st.sampled_from([0, 1, BACKGROUND])),
    hnp.arrays(np.float32, (6, 9), elements=st.sampled_from([0.0, 0.5, 0.508, 0.515, 0.6])),
    st.sampled_from([1, 70]),
)
def test_against_the_definition(mask: np.ndarray, true: np.ndarray, blow_up: int) -> None:
    mask, true = (np.repeat(a, blow_up, axis=1) for a in (mask, true))
    found = edge_band(true, mask).astype(bool)
    expected = slowly(true, mask)
    objects = mask != BACKGROUND
    assert np.array_equal(found & objects, expected & objects)


def test_a_slope_is_no_edge_and_a_step_within_an_object_is() -> None:
    true = np.broadcast_to(np.linspace(0.5, 0.7, 200, dtype=np.float32), (50, 200)).copy()
    mask = np.zeros((50, 200), np.uint8)
    assert not edge_band(true, mask).any()
    true[:, 100:] += 0.02
    columns = np.flatnonzero(edge_band(true, mask).any(axis=0))
    assert columns.tolist() == [99, 100]


def test_missing_ground_truth_is_no_step() -> None:
    true = np.ones((20, 20), np.float32)
    true[8:12, 8:12] = 0
    assert not edge_band(true, np.zeros((20, 20), np.uint8)).any()


def test_the_band_grows_with_the_image() -> None:
    for width, each_side in ((224, 1), (640, 3), (1280, 6)):
        mask = np.full((40, width), BACKGROUND, np.uint8)
        mask[:, width // 2 :] = 0
        band = edge_band(np.ones(mask.shape, np.float32), mask)
        assert band[20].sum() == 2 * each_side


def test_nothing_to_look_at() -> None:
    mask = np.full((5, 7), BACKGROUND, np.uint8)
    assert not edge_band(np.ones((5, 7), np.float32), mask).any()
