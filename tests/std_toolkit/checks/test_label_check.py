"""Labels that change are judged anew, and only what changed is measured again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from toy_balls import Toy, write_toy

from std_toolkit.checks import label_check
from std_toolkit.checks.label_check import LabelCheck
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene
from std_toolkit.scene.memory_scene import MemoryScene
from std_toolkit.scene.model import pose_from_list

pytestmark = pytest.mark.slow


@pytest.fixture()
def scene(tmp_path: Path) -> Scene:
    return Scene.open(write_toy(tmp_path / "toy", Toy(frames=5, arc_deg=40)).root)


@pytest.fixture()
def measured(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, tuple[int, ...]]]:
    """Frame and objects of every measurement."""
    calls: list[tuple[int, tuple[int, ...]]] = []
    measure = label_check.measure_frame

    def counted(scene: Scene, caster: Any, frame: Any, options: Any, *, only: Sequence[int]) -> Any:
        calls.append((frame.id, tuple(only)))
        return measure(scene, caster, frame, options, only=only)

    monkeypatch.setattr(label_check, "measure_frame", counted)
    return calls


def moved(scene: Scene, object_id: int, mm: float) -> Scene:
    label = scene.labels.of(object_id)
    assert label is not None and label.T_world_obj is not None
    T = pose_from_list(label.T_world_obj)
    T = SE3(T.R, T.t + np.array([mm / 1000, 0, 0]))
    label = msgspec.structs.replace(label, T_world_obj=T.flat())
    return MemoryScene(scene, labels=scene.labels.with_label(label))


def test_only_the_label_that_moved_is_measured_again(
    scene: Scene, measured: list[tuple[int, tuple[int, ...]]]
) -> None:
    check = LabelCheck()
    before = check.judge(scene, [1, 2])
    assert measured == [(i, (1, 2)) for i in range(5)]
    measured.clear()
    assert check.judge(scene, [1])[1].judgement.reason == before[1].judgement.reason
    assert measured == []
    after = check.judge(moved(scene, 1, 12), [1, 2])
    assert measured == [(i, (1,)) for i in range(5)]
    assert after[1].judgement.grade in ("doubtful", "wrong")
    assert after[2].judgement.grade == before[2].judgement.grade
    # Nothing was written.
    assert Scene.open(scene.root).labels == scene.labels


def test_it_goes_on_in_turns_and_stops_when_it_is_cancelled(
    scene: Scene, measured: list[tuple[int, tuple[int, ...]]]
) -> None:
    check = LabelCheck()
    assert not check.measure(scene, cancelled=lambda: len(measured) >= 2)
    assert len(measured) == 2
    assert not check.measure(scene, seconds=0.0)
    assert check.measure(scene)
    assert [i for i, _ in measured] == list(range(5))


def test_a_damaged_image_is_left_out(scene: Scene) -> None:
    path = scene.color_path(scene.frames[2])
    path.write_bytes(path.read_bytes()[:200])
    found = LabelCheck().judge(scene, [1])[1].judgement
    assert found.grade != "wrong" and found.probability is not None
    assert all(e.frames <= 4 for e in found.evidence)
