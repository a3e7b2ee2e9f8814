"""The picture of the first screen, made by its script at the shipped settings."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.io.images import read_color

REPOSITORY = Path(__file__).resolve().parents[3]
PICTURES, RESULTS = REPOSITORY / "docs/pictures", REPOSITORY / "docs/results/restore.csv"


@pytest.mark.real
@pytest.mark.slow
def test_the_first_screen_is_what_is_restored(test_data, monkeypatch) -> None:
    monkeypatch.syspath_prepend(str(PICTURES))
    import first_screen

    made, figures = first_screen.picture(test_data / "cleargrasp_real" / "real-val")
    sys.modules.pop("first_screen")
    shown = read_color(PICTURES / "first_screen.jpg")
    assert shown.shape == made.shape
    assert np.abs(shown.astype(int) - made).mean() < 3  # of JPEG
    with RESULTS.open() as file:
        held = {row["name"]: float(row["value"]) for row in csv.DictReader(file)}
    for name in first_screen.SHOWN:
        rmse, _, harmed, *_ = figures[name]
        assert rmse == pytest.approx(held[f"restore.{name[-3:]}.rmse_mm"], abs=0.5)
        assert harmed == pytest.approx(held[f"restore.{name[-3:]}.harm"], abs=0.05)
    for place, name in enumerate(("rmse_mm", "d105", "harm", "spread1", "spread2")):
        mean = np.mean([values[place] for values in figures.values()])
        assert mean == pytest.approx(held[f"restore.real.{name}"], abs=0.5)
