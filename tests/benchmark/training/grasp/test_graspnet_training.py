"""GraspNet through std-train: from scenes to weights to grasps that hold."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.cli.train import main as train_main
from benchmark.methods.grasp.graspnet.cloud import GraspNetConfig
from benchmark.training.catalogue import get_trainable
from benchmark.training.fit import fit
from benchmark.training.grasp.packed_grasps import PackedGrasps
from benchmark.training.options import Machine, TrainOptions
from benchmark.training.plan import plan_training
from std_toolkit.errors import ToolkitError
from tests.benchmark.training.grasp.grasp_scene import OPTIONS, TINY, pack_scene

GRID = GraspNetConfig().depths
HERE = Machine(accelerator="cpu", readers=0, log_every=1, progress=False)
SETTINGS = {
    "points": "512",
    "level_points": "192,96,32,16",
    "level_neighbours": "8,8,8,8",
    "width": "16",
    "views": "60",
    "angles": "6",
    "depths": "0.01,0.03",
    "cylinder_points": "16",
    "margin": "0.03",
}


@pytest.fixture(scope="module")
def two_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack_scene(tmp_path_factory.mktemp("grasps") / "two", OPTIONS, scenes=2)


def wishes(pack: Path, **changes: object) -> TrainOptions:
    made = TrainOptions(
        method="graspnet", settings=SETTINGS, data=[pack], hold_out=0.5, steps=4, checkpoint_every=2
    )
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_training_runs_is_judged_and_goes_on_with_the_same_weights(two_scenes, tmp_path):
    config, data, beginning = plan_training(wishes(two_scenes))
    assert len(data.of_training) == len(data.of_validation) == 2
    assert config.optimization.batch_size == 2
    whole = fit(tmp_path / "whole", config, data, HERE, beginning)
    told = json.loads((whole.parent / "best.json").read_text())
    assert told["ranked_by"] == "1 - AP"
    assert set(told["scores"]) == {"loss", "ap", "ap08", "ap04"}
    assert list((whole.parent / "gallery").glob("*.jpg"))
    rows = (whole.parent / "steps.csv").read_text().splitlines()
    assert len(rows) == 5
    assert {"objectness", "views", "turn", "width"} <= set(rows[0].split(","))
    # Stopped after half of the steps: what was begun for as many goes on to the same end.
    import benchmark.training.grasp.grasp_step as steps

    class Stop(Exception):
        pass

    def until(network, loss, seen, step_info):
        if step_info.step == 2:
            raise Stop
        return steps.grasp_step(network, loss, seen, step_info)

    trainable = get_trainable("graspnet")
    step = trainable.step
    object.__setattr__(trainable, "step", until)
    try:
        with pytest.raises(Stop):
            fit(tmp_path / "again", config, data, HERE, beginning)
    finally:
        object.__setattr__(trainable, "step", step)
    again = fit(tmp_path / "again", config, data, HERE, beginning)
    last = [path.parent / "last.safetensors" for path in (whole, again)]
    assert last[0].read_bytes() == last[1].read_bytes()


def test_what_does_not_fit_is_refused(two_scenes, grasp_pack, tmp_path):
    with pytest.raises(ToolkitError) as told:
        plan_training(wishes(two_scenes, settings={}))
    assert told.value.field == "views"
    with pytest.raises(ToolkitError, match="frames of validation are of scenes"):
        plan_training(wishes(two_scenes, validation=[grasp_pack]))
    with pytest.raises(ToolkitError, match="no folder of packed grasps"):
        plan_training(wishes(tmp_path))
    for augmented in ({"colors": "on"}, {"object_dropout": 0.5}):
        with pytest.raises(ToolkitError, match="no images to augment"):
            plan_training(wishes(two_scenes, **augmented))


@pytest.mark.slow
def test_scenes_are_made_by_the_command_and_more_are_added(tmp_path, capsys):
    command = ["pack-grasps", str(tmp_path), "--frames", "1", "--objects", "1", "2"]
    command += ["--sizes", "0.3", "0.4", "--spacing", "0.03", "--size", "160", "90"]
    command += ["--points", "3000", "--engine", "serial"]
    assert train_main([*command, "--scenes", "1"]) == 0
    assert "1 scenes, 1 frames" in capsys.readouterr().out
    first = (tmp_path / "scene-00000.json").read_bytes()
    assert train_main([*command, "--scenes", "2"]) == 0
    assert "2 scenes, 2 frames" in capsys.readouterr().out
    assert (tmp_path / "scene-00000.json").read_bytes() == first
    frames = PackedGrasps([tmp_path], replace(TINY, views=300, angles=12, depths=GRID))
    assert len({frames.scene(i) for i in range(2)}) == 2
    assert train_main([*command, "--scenes", "2", "--seed", "9"]) != 0
    assert "this pack was begun with 0" in capsys.readouterr().err
