"""Figures of a real sensor on real captures of transparent objects, as published with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from frames_to_score import TRANSPARENT, by_name, frame

from benchmark.data.frame import BACKGROUND, Instance
from benchmark.metrics.protocols import get_protocol, score_sensor
from std_toolkit.io.exr import read_exr_depth
from std_toolkit.io.images import read_mask

pytestmark = pytest.mark.real

# Over valid pixels of a 126x224 grid: % answered, RMSE, REL, MAE, % within 1.05, 1.10, 1.25.
PUBLISHED = {
    "080": "54.9 .0604 .0998 .0500 30.28 51.85 97.77",
    "123": "76.6 .0216 .0240 .0161 87.46 98.63 100",
    "130": "25.0 .0299 .0345 .0223 73.20 96.25 100",
}


@pytest.mark.parametrize("capture", list(PUBLISHED))
def test_to_the_last_printed_digit(test_data: Path, capture: str) -> None:
    stem = test_data / "cleargrasp_real" / "real-val" / f"000000{capture}"
    raw, true = (
        np.nan_to_num(read_exr_depth(f"{stem}-{kind}-depth-img.exr"), nan=0)
        for kind in ("transparent", "opaque")
    )
    mask = np.where(read_mask(f"{stem}-mask.png") > 0, 1, BACKGROUND)
    at = frame(true, mask, (Instance(1, 0, TRANSPARENT),), raw=raw)
    found = by_name(score_sensor(at, get_protocol()))["h126w224", "all"].errors
    figures = (
        100 * found.coverage,
        found.rmse_answered,
        found.rel_answered,
        found.mae_answered,
        100 * found.d105_answered,
        100 * found.d110_answered,
        100 * found.d125_answered,
    )
    published = PUBLISHED[capture].split()
    printed = [
        f"{value:.{len(text.partition('.')[2])}f}".removeprefix("0" if text[0] == "." else "")
        for value, text in zip(figures, published, strict=True)
    ]
    assert printed == published
    # What the sensor left out costs in the figures that methods are compared by.
    assert found.rmse > 2 * found.rmse_answered
    assert found.rel == pytest.approx(
        found.coverage * found.rel_answered + 1 - found.coverage, rel=1e-12
    )
