"""The paper's protocol gives the figures of the paper's released evaluation."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from frames_to_score import frame

from benchmark.data.frame import BACKGROUND
from benchmark.evaluation.tasks.depth_results import summarise
from benchmark.metrics.protocols import get_protocol, score_frame

DATA = Path(__file__).resolve().parents[3] / "data"
EXPECTED = json.loads((DATA / "depth_metrics_oracle.json").read_text())["frames"]
NAMES = {
    "rmse": "rmse",
    "rel": "rel",
    "mae": "mae",
    "d105": "delta_1.05",
    "d110": "delta_1.10",
    "d125": "delta_1.25",
}
NEGATIVE, EMPTY = 4, 5  # frames of the oracle


def scored(index: int, protocol: str) -> dict[str, float]:
    with np.load(DATA / "depth_metrics_oracle.npz") as arrays:
        true, pred = (
            (arrays[f"{name}_{index}"] * 1e-4).astype(np.float32) for name in ("gt", "pred")
        )
        mask = np.where(arrays[f"mask_{index}"], 0, BACKGROUND)
    object_of = frame(true).instances
    rows = score_frame(pred, frame(true, mask, object_of), get_protocol(protocol))
    return rows[0].errors.as_dict()


@pytest.mark.parametrize("index", [i for i in range(len(EXPECTED)) if i != EMPTY])
def test_frames(index: int) -> None:
    found = scored(index, "paper")
    for ours, theirs in NAMES.items():
        assert found[ours] == pytest.approx(EXPECTED[index][theirs], abs=1e-6, rel=0), ours


def test_negative_predictions_are_hits_only_for_the_paper() -> None:
    paper, strict = scored(NEGATIVE, "paper"), scored(NEGATIVE, "strict")
    assert paper["coverage"] == pytest.approx(0.696, abs=1e-3)
    # Every answered pixel there is within 1.25; all negative ones are hits on top of that.
    assert paper["d125"] > 0.999
    assert paper["d105"] - paper["d105_answered"] * paper["coverage"] == pytest.approx(
        1 - paper["coverage"]
    )
    assert strict["d125"] <= strict["coverage"] < 0.70
    assert strict["d105"] == pytest.approx(strict["d105_answered"] * strict["coverage"])


def test_the_empty_frame_enters_no_mean() -> None:
    assert EXPECTED[EMPTY]["valid_images"] == 0
    found = scored(EMPTY, "paper")
    assert found["n_pixels"] == 0
    assert math.isnan(found["rmse"])
    rows = pd.DataFrame([{"method": "m", **scored(i, "paper")} for i in range(len(EXPECTED))])
    table = summarise(rows).iloc[0]
    assert (table["frames"], table["frames_empty"]) == (5, 1)
    valid = [e for i, e in enumerate(EXPECTED) if i != EMPTY]
    for ours, theirs in NAMES.items():
        assert table[ours] == pytest.approx(np.mean([e[theirs] for e in valid]), abs=1e-6)


def test_the_grid_is_the_transposed_one() -> None:
    """The figures of the other shape are so far off that the oracle tells them apart."""
    strict = scored(2, "strict")
    assert abs(strict["rmse"] - EXPECTED[2]["rmse"]) > 1e-4
