"""Wrong labels do not pass the check, and right ones do."""

from __future__ import annotations

from pathlib import Path

import pytest
from fault_table import Study, cases

from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
from std_toolkit.jobs import JobOptions
from std_toolkit.scene import Scene

# What is tried in short; the long form tries every fault on every object.
SHORT = (
    "cereal_box along 5 mm",
    "cereal_box turned 180 deg",
    "soup_can upside down",
    "mug tilted 2 deg",
    "mug moved 20 mm in the second half",
    "glass 300 mm beside",
    "glass mesh 5 % too small",
    "camera 3 off by 30 mm, 2 deg",
    "depth shifted by 5 px",
    "poses and labels 2 % too large",
    "two objects swapped",
)


def complaints(scene: Scene, names: tuple[str, ...] | None = None) -> list[str]:
    """The faults of which the check does not say what it should."""
    study = Study(scene)
    plain = study.plain()
    noted = [f"{w.about}: {w.problem}" for w in plain.warnings if w.severity != "low"]
    found = [] if plain.passed and not noted else [f"no fault: {plain.verdict}; {noted}"]
    tried = [c for c in cases(scene) if names is None or c.name in names]
    assert names is None or len(tried) == len(names)
    for case in tried:
        outcome = study.outcome(case)
        if not outcome.satisfies(case):
            found.append(f"{case.name}: {case.wanted}, not {outcome.said}: {outcome.text}")
    return found


@pytest.mark.slow
def test_the_check_finds_faults(synthetic_table: Path, tmp_path: Path) -> None:
    assert complaints(scene_from_truth(synthetic_table, tmp_path / "scene"), SHORT) == []


@pytest.mark.long
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("seed", [0, 2, 3])
def test_the_check_finds_every_fault_of_every_object(seed: int, tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    make_recording(recording, RecordingOptions(frames=8, seed=seed), jobs=JobOptions())
    found = complaints(scene_from_truth(recording, tmp_path / "scene"))
    # A motion of 2 degrees is near what eight frames can tell: a few warnings may be missing.
    small = [c for c in found if ": warn, not pass" in c]
    assert [c for c in found if c not in small] == []
    assert len(small) <= 2, small
