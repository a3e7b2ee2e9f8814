"""Precisions of detection are those of bop_toolkit's own program, to 1e-9.

`tests/data/bop_oracle.json` has its answers for a result file of LM-O: the true poses disturbed,
15 % missing, 20 % doubled, with random scores. `bop_oracle_errors.npz` has the errors of these
estimates, so that the scores are checked everywhere; the whole way needs LM-O's poses and models.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bop_set import BRICK, CAN, DIAMETERS_M, TRUTHS, write_bop
from lmo_set import write_lmo

from benchmark.evaluation.tasks.bop_results import summarise
from benchmark.metrics.bop import (
    BopEstimate,
    BopScorer,
    Detections,
    DetectionScores,
    detection_scores,
    open_bop,
    read_bop_results,
    score_bop_detection,
)
from std_toolkit.geometry import SE3

DATA = Path(__file__).parents[3] / "data"
ANSWERS: dict[str, dict[str, float]] = {
    name: answers
    for name, answers in json.loads((DATA / "bop_oracle.json").read_text()).items()
    if name != "about"
}
LAYOUTS = list(ANSWERS)
WIDTH = 640


def hardly_visible(layout: str) -> float:
    """Visible share of the instances without an estimate's target."""
    return 0.0 if layout.startswith("visib_fract 0") else 1.0


def figures(found: DetectionScores) -> dict[str, float]:
    return {
        "bop24_mAP": found.map,
        "bop24_mAP_mspd": found.mspd,
        "bop24_mAP_mssd": found.mssd,
        "bop24_mAP_mssd_mm": found.mssd_mm,
        "bop25_mAP": found.mssd,
        "bop25_mAP_mm": found.mssd_mm,
    }


def kept_errors(layout: str) -> list[tuple[int, int, Detections]]:
    with np.load(DATA / "bop_oracle_errors.npz") as kept:
        errors = dict(kept)
    diameter = dict(zip(errors["objects"].tolist(), errors["diameters_m"].tolist(), strict=True))
    ends = np.cumsum(errors["estimates"].astype(int))
    parts = {name: np.split(errors[name], ends[:-1]) for name in ("scores", "mssd", "mspd")}
    rows = []
    for k, (image, obj_id) in enumerate(zip(errors["image"], errors["obj_id"], strict=True)):
        share = 1.0 if errors["listed"][k] else hardly_visible(layout)
        scores, mssd, mspd = (parts[name][k] for name in ("scores", "mssd", "mspd"))
        found = Detections(
            scores, mssd[:, None], mspd[:, None], np.array([share]), diameter[int(obj_id)], WIDTH
        )
        rows.append((int(image), int(obj_id), found))
    return rows


@pytest.mark.parametrize("layout", LAYOUTS)
def test_scores_are_those_of_bop_toolkit(layout: str) -> None:
    found = figures(detection_scores(kept_errors(layout)))
    assert found == {name: pytest.approx(x, abs=1e-9) for name, x in ANSWERS[layout].items()}


def test_the_layouts_differ() -> None:
    """A scorer that ignored the visible shares would pass neither."""
    first, second = (ANSWERS[layout]["bop25_mAP_mm"] for layout in LAYOUTS)
    assert abs(first - second) > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_whole_way_gives_the_same(layout: str, test_data: Path, tmp_path: Path) -> None:
    results = test_data.parent / "reference" / "bop_oracle_noisy_lmo-test.csv"
    if not results.is_file():
        pytest.skip(f"known answers not found at {results.parent}")
    root = write_lmo(
        test_data / "lmo_poses", tmp_path / "lmo", unlisted_visible=hardly_visible(layout)
    )
    dataset = open_bop(root, symmetry_steps=315)
    scorer = BopScorer(dataset, read_bop_results(results), errors=("mssd", "mspd"))
    rows = []
    for place, image in enumerate(scorer.images):
        for obj_id in scorer.objects(*image):
            found = scorer.errors(*image, obj_id, scorer.image(*image)).detections
            assert found is not None
            rows.append((place, obj_id, found))
    answers = {name: pytest.approx(x, abs=1e-9) for name, x in ANSWERS[layout].items()}
    assert figures(detection_scores(rows)) == answers
    kept = kept_errors(layout)
    assert [row[:2] for row in rows] == [row[:2] for row in kept]
    for (*_, mine), (*_, theirs) in zip(rows, kept, strict=True):
        assert mine.mssd is not None and mine.mspd is not None
        np.testing.assert_allclose(mine.mssd, theirs.mssd, atol=1e-12)
        np.testing.assert_allclose(mine.mspd, theirs.mspd, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("off_mm", "share"), [(1.9, 1.0), (2.1, 0.9), (9.9, 0.6), (20.1, 0.0)])
def test_millimetres_do_not_depend_on_the_size(tmp_path: Path, off_mm: float, share: float) -> None:
    """An object that is off by 9.9 mm is right within 10, 12, ..., 20 mm, whatever its diameter."""
    root = write_bop(tmp_path / "set")
    aside = np.array([off_mm / 1000, 0, 0])
    estimates = [
        BopEstimate(2, image, number, 0.5, SE3(T.R, T.t + aside))
        for image, rows in TRUTHS.items()
        for number, T in rows
    ]
    found = score_bop_detection(open_bop(root), estimates)
    assert found.mssd_mm == pytest.approx(share)
    for number in (CAN, BRICK):
        limits = np.arange(1, 11) * 50 * DIAMETERS_M[number]
        assert found.objects[number][0] == pytest.approx(np.mean(off_mm < limits))
        assert found.objects[number][2] == pytest.approx(share)


def test_bop_toolkits_names_are_written(tmp_path: Path) -> None:
    import pandas as pd

    rows = [
        {
            "index": image, "scene": "000002", "frame": str(image), "error": "", "obj_id": obj_id,
            "n_estimates": 0, "n_valid": 0, "found_vsd": np.nan, "found_mssd": np.nan,
            "found_mspd": np.nan, "scores": d.scores.tolist(), "visible": d.visible.tolist(),
            "mssd": d.mssd.ravel().tolist(), "mspd": d.mspd.ravel().tolist(),
            "diameter_m": d.diameter_m, "width": d.width,
        }
        for image, obj_id, d in kept_errors(LAYOUTS[0])
        if d.mssd is not None and d.mspd is not None
    ]  # fmt: skip
    names = {"results": "noisy", "data": "lmo", "split": "test"}
    result = summarise(pd.DataFrame(rows), **names, estimates=1, seconds_per_image=None)
    result.write_scores(tmp_path)
    written = json.loads((tmp_path / "scores_bop24.json").read_text())
    for name, answer in ANSWERS[LAYOUTS[0]].items():
        assert written[name] == pytest.approx(answer, abs=1e-9)
    assert result.ap_mssd_mm == written["bop25_mAP_mm"]
