"""Runs of pose methods: what depth decides, what methods see, going on, and what fails."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.data.frame import Material
from benchmark.evaluation.depth_choice import DepthChoice
from benchmark.evaluation.engine import UnusableMethod, run_task
from benchmark.evaluation.manifest import POSE_MANIFEST
from benchmark.evaluation.results import ERROR, INDEX
from benchmark.evaluation.tasks.depth import save_depth
from benchmark.evaluation.tasks.pose_results import (
    HARD,
    read_pose_results,
    read_pose_run,
    score_run,
)
from benchmark.evaluation.tasks.pose_table import FOUND, KIND, POSES, TRUE, frames_of
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.pose import get_pose_protocol
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.pose_set import SERIAL, SPLIT, a_pose_run, write_pose_split

HERE = "tests.benchmark.evaluation.pose_set"
STRICT = get_pose_protocol("strict")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pose_split(tmp_path_factory.mktemp("data"))


@pytest.mark.parametrize("box", ["true", "seen"])
@pytest.mark.parametrize("protocol", ["strict", "paper", "nocs2019"])
def test_true_coordinates_and_true_depth_are_right_in_every_column(
    root: Path, tmp_path: Path, protocol: str, box: str
) -> None:
    run = a_pose_run(root, tmp_path, "gt", options=MethodOptions(settings={"box": box}))
    run_task(run, SERIAL)
    scores = score_run(read_pose_run(run.folder), get_pose_protocol(protocol)).scores
    assert scores.true_objects.tolist() == [4, 0, 4, 0, 0, 4, 0]
    for name in ("bottle", "camera", "mug"):
        assert set(scores.of_class(name).values()) == {1.0}, name


def test_raw_depth_of_glass_is_worse(root: Path, tmp_path: Path) -> None:
    run = a_pose_run(root, tmp_path, "raw")
    run_task(run, SERIAL)
    result = read_pose_run(run.folder)
    everything = score_run(result, STRICT).scores
    assert everything.of_class("bottle")["10deg10cm"] < 0.5, "glass"
    assert everything.of_class("mug")["5deg5cm"] == 1.0, "the sensor sees this metal well"
    hard = score_run(result, STRICT, HARD)
    assert hard.scores.true_objects.tolist() == [4, 0, 0, 0, 0, 4, 0]
    assert hard.scores.mean["5deg5cm"] < everything.mean["5deg5cm"] < 1


def test_a_prediction_goes_with_the_object_that_it_belongs_to() -> None:
    # Two bottles, one of glass, in one frame; one car in another, where nothing is.
    def row(kind: str, index: int, class_id: int, x: float, material: int = -1) -> dict:
        numbers = dict.fromkeys((f"rt{i}{j}" for i in range(3) for j in range(4)), 0.0)
        numbers |= {"rt00": 1.0, "rt11": 1.0, "rt22": 1.0, "rt03": x, "rt23": 1.0}
        told = {INDEX: index, "scene": "s", "frame": str(index), ERROR: "", "read": True}
        sizes = {"size_x": 0.1, "size_y": 0.1, "size_z": 0.1}
        more = {"score": 0.5, "handle_visible": True, "material": material}
        return {**told, KIND: kind, "class_id": class_id, **numbers, **sizes, **more}

    table = pd.DataFrame(
        [
            row("frame", 0, -1, 0),
            row(TRUE, 0, 1, 0.0, Material.TRANSPARENT),
            row(TRUE, 0, 1, 0.5, Material.DIFFUSE),
            row(FOUND, 0, 1, 0.05),
            row(FOUND, 0, 1, 0.45),
            row("frame", 1, -1, 0),
            row(FOUND, 1, 5, 0.0),
        ]
    )
    frames = frames_of(table, frozenset({Material.TRANSPARENT}))
    assert [t.RT[:, 0, 3].tolist() for t in frames.truths] == [[0.0], []]
    assert [f.RT[:, 0, 3].tolist() for f in frames.found] == [[0.05], [0.0]]


def test_restored_and_saved_depth(root: Path, tmp_path: Path) -> None:
    from benchmark.data.splits import FrameKey, open_split
    from benchmark.methods.protocol import Restored

    source = open_split(SPLIT, root)
    for i in range(len(source)):
        frame = source.load(i)
        key = FrameKey(frame.scene, frame.name)
        save_depth(tmp_path / "saved", SPLIT, key, Restored(frame.depth_true))
    saved = DepthChoice(name="mine", folder=tmp_path / "saved" / "depth")
    run = a_pose_run(root, tmp_path / "out", depth=saved)
    run_task(run, SERIAL)
    means = score_run(read_pose_run(run.folder), STRICT).scores.mean
    assert set(means.values()) == {1.0}
    restored = a_pose_run(root, tmp_path / "out", "nearest")
    table = run_task(restored, SERIAL)
    assert (table[ERROR] == "").all()
    assert (table[KIND] == FOUND).sum() == 12
    names = {r.name for r in read_pose_results([tmp_path / "out"])}
    assert names == {("gt-nocs", "mine", "ransac"), ("gt-nocs", "nearest", "ransac")}


def test_restored_depth_has_the_size_and_the_details_of_the_sensor(root: Path) -> None:
    from benchmark.data.splits import open_split
    from benchmark.evaluation.depth_choice import DepthProvider

    frame = open_split(SPLIT, root).load(0)
    depth = DepthProvider(DepthChoice(name=f"{HERE}:Small"), SPLIT).depths({0: frame})[0]
    assert depth.shape == frame.depth_raw.shape
    assert (depth == frame.depth_raw).mean() > 0.9


@pytest.mark.parametrize("as_input", [False, True])
def test_networks_look_at_raw_depth_unless_told(root: Path, tmp_path: Path, as_input: bool) -> None:
    log = tmp_path / "log"
    options = MethodOptions(settings={"log": str(log)})
    run = a_pose_run(
        root, tmp_path / "out", "gt", method=f"{HERE}:Looking", options=options, as_input=as_input
    )
    run_task(replace(run, limit=1), SERIAL)
    sensor, depth = map(float, log.read_text().split())
    assert (sensor == depth) is as_input
    assert run.folder.parent.name == ("gt-as-input" if as_input else "gt")


def test_fits_differ(root: Path, tmp_path: Path) -> None:
    tables = {}
    for fit in ("ransac", "paper"):
        run = a_pose_run(root, tmp_path, "raw", fit=fit)
        tables[fit] = run_task(run, SERIAL)
        assert read_pose_run(run.folder).name == ("gt-nocs", "raw", fit)
    found = [t[t[KIND] == FOUND]["rt23"].to_numpy() for t in tables.values()]
    assert len(found[1]) == 12
    assert len(found[0]) != len(found[1]) or not np.allclose(*found)


def test_frames_that_fail_are_missed_and_tried_again(root: Path, tmp_path: Path) -> None:
    run = a_pose_run(root, tmp_path, "gt", method=f"{HERE}:FailsAtSome", label="fails")
    table = run_task(run, SERIAL)
    failed = sorted(set(table.loc[table[ERROR] != "", INDEX]))
    assert 0 < len(failed) < 4
    assert "cannot stand this frame" in table.loc[table[INDEX] == failed[0], ERROR].iloc[0]
    means = score_run(read_pose_run(run.folder), STRICT).scores.mean
    assert means["iou25"] == pytest.approx(1 - len(failed) / 4)
    again = run_task(run, SERIAL)
    pd.testing.assert_frame_equal(table, again)


def test_a_frame_that_cannot_be_read_is_told_and_not_scored(tmp_path: Path) -> None:
    root = write_pose_split(tmp_path / "data", scenes=1, frames=3)
    (root / "DREDS-CatKnown" / "test" / "1" / "0001_mask.exr").write_bytes(b"nothing")
    run = a_pose_run(root, tmp_path / "out", "gt")
    table = run_task(run, SERIAL)
    assert set(table.loc[table[ERROR] != "", INDEX]) == {1}
    scored = score_run(read_pose_run(run.folder), STRICT)
    assert len(scored.scenes) == 2
    assert set(scored.scores.mean.values()) == {1.0}


@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_same_table(root: Path, tmp_path: Path) -> None:
    settings = {"mark": str(tmp_path / "mark")}
    run = a_pose_run(
        root, tmp_path / "out", method=f"{HERE}:DiesOnce", options=MethodOptions(settings=settings)
    )
    jobs = JobOptions(workers=1, progress=False)
    try:
        run_task(replace(run, batch_size=1), jobs)
    except ToolkitError:
        run_task(replace(run, batch_size=1), jobs)
    assert (tmp_path / "mark").exists()
    calm = replace(run, out=tmp_path / "calm", batch_size=1)
    run_task(calm, SERIAL)
    assert (run.folder / POSES).read_bytes() == (calm.folder / POSES).read_bytes()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"depth": DepthChoice(name="swinnet")}, "swinnet"),
        ({"depth": DepthChoice(name="mine", folder=Path("/nowhere"))}, "/nowhere"),
        ({"method": "nocz"}, "nocz"),
        ({"options": MethodOptions(settings={"bax": "true"})}, "bax.*no such setting"),
        ({"method": "json:loads"}, "cannot be made"),
    ],
)
def test_what_cannot_be_made_is_told_at_once(
    root: Path, tmp_path: Path, changes: dict, told: str
) -> None:
    with pytest.raises(UnusableMethod, match=told):
        run_task(a_pose_run(root, tmp_path, **changes), SERIAL)


def test_another_run_in_the_same_folder(root: Path, tmp_path: Path) -> None:
    run = a_pose_run(root, tmp_path, "gt", limit=1)
    run_task(run, SERIAL)
    with pytest.raises(ToolkitError, match=rf"{POSE_MANIFEST}.*setup\.frames"):
        run_task(replace(run, limit=2), SERIAL)


def test_splits_without_poses_are_told(tmp_path: Path) -> None:
    from tests.dreds_on_disk import write_dreds_scene

    write_dreds_scene(tmp_path / "DREDS-CatKnown" / "test" / "1", short_meta=True)
    with pytest.raises(ToolkitError, match="no normalised coordinates"):
        run_task(a_pose_run(tmp_path, tmp_path / "out"), SERIAL)
