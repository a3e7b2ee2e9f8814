"""Labels of a simulated annotator on synthetic recordings, against their truth.

The figures that the annotator must reach; perf/annotate_accuracy.py prints more of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from simulated_annotator import Attempt, SimulatedAnnotator, Start, scene_to_annotate

from sensors.synthetic import RecordingOptions, make_recording

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

# Of nine frames over 120 degrees: at both ends and in the middle.
THREE = (0, 4, 8)
# How the objects of each recording are placed: other places, textures, and paths of the camera.
STARTS: dict[int, tuple[Start, ...]] = {1: ("clicks", "hand"), 2: ("hand",)}


@pytest.fixture(
    scope="module",
    params=[
        pytest.param((1,), id="short"),
        pytest.param((1, 2), id="long", marks=pytest.mark.long),
    ],
)
def recordings(
    request: pytest.FixtureRequest, synthetic_table: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[int, Path]:
    """Six objects on a table, by seed."""
    found = {1: synthetic_table}
    for seed in request.param:
        if seed not in found:
            found[seed] = tmp_path_factory.mktemp("recording") / f"recording_{seed}"
            make_recording(found[seed], RecordingOptions(frames=9, seed=seed))
    return found


@pytest.fixture(scope="module")
def without_depth(
    recordings: dict[int, Path], tmp_path_factory: pytest.TempPathFactory
) -> list[Attempt]:
    """Every object, from clicks and from 30 mm and 15 degrees off, in three images."""
    return list(attempts(recordings, tmp_path_factory.mktemp("scenes"), depth=False))


@pytest.fixture(scope="module")
def with_depth(
    recordings: dict[int, Path], tmp_path_factory: pytest.TempPathFactory
) -> list[Attempt]:
    """The same with what the sensor measured: nothing on glass, nonsense on steel."""
    return list(attempts(recordings, tmp_path_factory.mktemp("scenes"), depth=True))


def attempts(recordings: dict[int, Path], folder: Path, *, depth: bool) -> Iterator[Attempt]:
    for seed, recording in recordings.items():
        scene = scene_to_annotate(recording, folder / str(seed), depth=depth)
        annotator = SimulatedAnnotator(recording, scene.root)
        for start in STARTS[seed]:
            yield from annotator.label(start=start, frames=THREE, seed=seed)


def medians(tried: list[Attempt]) -> tuple[float, float]:
    return float(np.median([a.mm for a in tried])), float(np.median([a.deg for a in tried]))


@pytest.mark.long
def test_starts_are_as_bad_as_they_are_said_to_be(without_depth: list[Attempt]) -> None:
    by_hand = [a for a in without_depth if a.start == "hand"]
    assert min(a.start_mm for a in by_hand) > 30
    assert max(a.start_deg for a in by_hand) > 14.9
    clicked = [a for a in without_depth if a.start == "clicks"]
    assert np.median([a.start_mm for a in clicked]) > 1


def test_opaque_objects(with_depth: list[Attempt]) -> None:
    mm, deg = medians([a for a in with_depth if a.material == "diffuse"])
    assert mm <= 1.5, with_depth
    assert deg <= 0.7, with_depth


def test_objects_that_the_sensor_does_not_see(with_depth: list[Attempt]) -> None:
    for material in ("transparent", "specular"):
        mm, deg = medians([a for a in with_depth if a.material == material])
        assert mm <= 2.5, with_depth
        assert deg <= 1.0, with_depth


@pytest.mark.long
@pytest.mark.parametrize("material", ["diffuse", "transparent", "specular"])
def test_three_views_without_any_depth(without_depth: list[Attempt], material: str) -> None:
    mm, deg = medians([a for a in without_depth if a.material == material])
    assert mm <= 2.5, without_depth
    assert deg <= 1.0, without_depth


@pytest.mark.long
def test_no_object_is_lost(with_depth: list[Attempt], without_depth: list[Attempt]) -> None:
    tried = [*with_depth, *without_depth]
    lost = [a for a in tried if a.mm > 5 or a.deg > 3]
    assert len(lost) <= 0.05 * len(tried), lost
