"""Scale of the camera poses by the sizes of the labelled objects, and its warning."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from toy_balls import Toy

from std_toolkit.checks.gates.gate import Measured
from std_toolkit.checks.gates.judge import judge_rows
from std_toolkit.checks.measure.object_sizes import (
    ObjectSize,
    combine_sizes,
    measure_sizes,
    object_sizes,
)
from std_toolkit.checks.result import CheckWarning, SceneSummary
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene
from std_toolkit.scene.model import Pose16, ScaleEstimate, ScaleReport

MakeScene = Callable[[Toy], Scene]
SUMMARY = SceneSummary(
    frames=6, registered=6, looked_at=6, objects=2, labelled=2, depth_frames=0, truth_frames=0
)


def size(name: str, factor: float, error: float = 0.001) -> ObjectSize:
    return ObjectSize(name=name, model=name, factor=factor, standard_error=error)


def warnings(sizes: ScaleEstimate | None, scale: ScaleReport | None = None) -> list[CheckWarning]:
    summary = msgspec.structs.replace(SUMMARY, sizes=sizes, scale=scale)
    measured = Measured(summary=summary, objects=[], frames=[], options=CheckOptions())
    return [w for w in judge_rows(measured).warnings if "sizes of the objects ask" in w.problem]


def scaled(scene: Scene, factor: float) -> Scene:
    """Camera poses and labels multiplied alike, as a wrong scale source leaves them."""

    def larger(T: Pose16) -> Pose16:
        return [x * factor if i in (3, 7, 11) else x for i, x in enumerate(T)]

    assert scene.poses is not None
    frames = [
        msgspec.structs.replace(f, T_world_cam=larger(f.T_world_cam or []))
        for f in scene.poses.frames
    ]
    scene.save_poses(msgspec.structs.replace(scene.poses, frames=frames))
    labels = [
        msgspec.structs.replace(x, T_world_obj=larger(x.T_world_obj or []))
        for x in scene.labels.labels
    ]
    scene.save_labels(msgspec.structs.replace(scene.labels, labels=labels))
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 1.02])
def test_poses_and_labels_of_a_wrong_scale_are_told(make_scene: MakeScene, factor: float) -> None:
    scene = scaled(make_scene(Toy(depth_error_m=None)), factor)
    found = measure_sizes(scene)
    assert found is not None
    assert found.factor * factor == pytest.approx(1, abs=0.005)
    assert abs(found.factor * factor - 1) < 3 * found.sigma
    told = warnings(found)
    assert bool(told) == (factor != 1)
    if told:
        word = "smaller" if factor > 1 else "larger"
        assert word in told[0].problem
        assert "--refine-scale" in told[0].advice


def test_a_scene_without_poses_or_labels_tells_no_scale(make_scene: MakeScene) -> None:
    scene = make_scene(Toy(frames=2))
    scene.save_labels(msgspec.structs.replace(scene.labels, labels=[]))
    assert object_sizes(scene) == []
    assert measure_sizes(scene) is None


def test_objects_that_agree_are_fused() -> None:
    found = combine_sizes([size(n, 0.98) for n in "abcd"])
    assert found is not None
    assert found.factor == pytest.approx(0.98)
    single = combine_sizes([size("a", 0.98)])
    assert single is not None
    assert found.sigma < single.sigma
    assert len(warnings(found)) == 1


def test_a_mesh_of_another_size_does_not_move_the_scale() -> None:
    found = combine_sizes([size("a", 1.001), size("b", 0.999), size("c", 1.05), size("d", 1.0)])
    assert found is not None
    assert found.factor == pytest.approx(1, abs=0.001)
    assert found.note.endswith("without c")
    assert warnings(found) == []


def test_objects_that_contradict_each_other_tell_nothing() -> None:
    assert combine_sizes([size("a", 1.05), size("b", 0.95), size("c", 1.0), size("d", 1.1)]) is None


def test_the_deviation_covers_the_scatter_of_the_objects() -> None:
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(200):
        true = np.exp(rng.normal(0, np.hypot(0.004, 0.003), 5))
        found = combine_sizes([size(f"{i}", float(f), 0.003) for i, f in enumerate(true)])
        if found is not None:
            errors.append((found.factor - 1) / found.sigma)
    assert len(errors) > 190
    assert np.std(errors) < 1.2


def test_one_object_warns_only_beyond_the_error_of_a_mesh() -> None:
    assert warnings(combine_sizes([size("a", 1.01)])) == []
    assert len(warnings(combine_sizes([size("a", 1.02)]))) == 1


def test_beside_a_board_the_meshes_are_suspected() -> None:
    estimate = ScaleEstimate(source="board", factor=1, spread=0, standard_error=0, count=9)
    report = ScaleReport(unit="metre", chosen="board", estimates=[estimate]).consistent()
    (told,) = warnings(combine_sizes([size("a", 1.02)]), report)
    assert told.advice.startswith("check the sizes of the meshes")
