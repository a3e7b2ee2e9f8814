"""Trainings of pose networks: gradients everywhere, resume, what they leave, what they refuse."""

from __future__ import annotations

import csv
import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from training_set import HERE, SIDE, packed, same, trained, wishes, write_scenes

from benchmark.cli.train import main
from benchmark.methods import registry
from benchmark.methods.registry import MethodOptions, make_pose_method
from benchmark.training.catalogue import get_trainable
from benchmark.training.export import bench_command
from benchmark.training.fit import make_network
from benchmark.training.options import TrainOptions
from benchmark.training.plan import plan_training
from benchmark.training.step import StepInfo, model_input
from std_toolkit.errors import ToolkitError
from tests.benchmark.methods.pose.learnt_poses import packed_things, write_things

TINY = {
    "swindrnet-nocs": {
        "input_size": f"{SIDE},{SIDE}",
        "channels": "8",
        "depths": "1,1,1,1",
        "heads": "1,1,1,1",
        "head_channels": "8",
    },
    "nocs": {
        "input_size": f"{SIDE},{SIDE}",
        "channels": "8",
        "blocks": "1,1,1,1",
        "pyramid": "8",
        "tower": "1",
        "region_channels": "8",
        "region_convs": "1",
    },
}
# The things of these scenes are some pixels wide at this size.
LOSS = {"swindrnet-nocs": {}, "nocs": {"least_pixels": "4"}}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("pose_data"))


@pytest.fixture(scope="module")
def pack(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return packed(tmp_path_factory.mktemp("poses") / "pack", data, nocs=True)


def asked(method: str, pack: Path, **changes: Any) -> TrainOptions:
    plain = wishes("dfnet", pack, settings=TINY[method])
    return replace(plain, **{"method": method, "loss": LOSS[method], **changes})


@pytest.mark.parametrize("method", TINY)
def test_every_parameter_of_a_pose_network_receives_a_gradient(method, tmp_path):
    """With objects that are as large as the detector looks for."""
    frames = packed_things(tmp_path / "pack", write_things(tmp_path / "data"), method)
    torch.manual_seed(0)
    trainable = get_trainable(method)
    network = trainable.network(trainable.config("compact", TINY[method])).train()
    assert not trainable.idle(network.config)
    optimizer = torch.optim.Adam(network.parameters(), 1e-4)
    moved = {name: torch.zeros_like(p) for name, p in network.named_parameters()}
    for step in range(3):  # what begins at 0 holds up the gradients of what is behind it
        optimizer.zero_grad()
        seen = model_input(frames[[0, 1]])
        trainable.step(network, trainable.loss, seen, StepInfo("", step, 3)).total.backward()
        optimizer.step()
        for name, parameter in network.named_parameters():
            assert parameter.grad is not None, name
            moved[name] += parameter.grad.abs()
    assert [name for name, total in moved.items() if not total.any()] == []


def test_std_bench_is_asked_for_the_task_of_a_method():
    assert bench_command("swindrnet") == "std-bench --method swindrnet"
    assert bench_command("swindrnet-nocs") == "std-bench pose --method swindrnet-nocs"
    assert bench_command("graspnet") == "std-bench grasp --planner graspnet"
    assert bench_command("mine:TRAINABLE") == "std-bench --method mine:TRAINABLE"


def test_the_released_fusion_is_known_to_leave_parameters_idle():
    trainable = get_trainable("swindrnet-nocs")
    assert trainable.settings_of("published", {}) == {"fusion": "paper"}
    assert trainable.idle(trainable.config("published", {}))
    assert not trainable.idle(trainable.config("published", {"fusion": "paper"}))


@pytest.mark.slow
@pytest.mark.parametrize("method", TINY)
def test_an_interrupted_training_of_poses_ends_with_the_same_weights(method, pack, tmp_path):
    whole = trained(asked(method, pack, colors="on"), tmp_path / "whole")
    config, data, beginning = plan_training(asked(method, pack, colors="on"))
    from benchmark.training import module
    from benchmark.training.fit import fit

    plain, steps = module.RestorerTraining.training_step, []

    def dies(self, batch, batch_idx):
        if len(steps) == 3:
            raise KeyboardInterrupt
        steps.append(batch_idx)
        return plain(self, batch, batch_idx)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module.RestorerTraining, "training_step", dies)
        with pytest.raises((KeyboardInterrupt, SystemExit)):
            fit(tmp_path / "cut", config, data, HERE, beginning)
    assert not (tmp_path / "cut" / "last.safetensors").exists()
    again = trained(asked(method, pack, colors="on"), tmp_path / "cut")
    assert same(whole, again)
    rows = list(csv.DictReader((tmp_path / "cut" / "steps.csv").open()))
    assert [row["step"] for row in rows] == ["1", "2", "3", "4", "5", "6"]


@pytest.mark.slow
@pytest.mark.parametrize("method", TINY)
def test_poses_are_learnt_in_bf16_with_parts_of_steps(method, pack, tmp_path):
    """Also with accumulated parts, some of which hold no object that is large enough."""
    weights = trained(asked(method, pack, precision="bf16", accumulate=2), tmp_path)
    assert {t.dtype for t in weights.values() if t.is_floating_point()} == {torch.float32}
    assert all(torch.isfinite(t).all() for t in weights.values())


@pytest.mark.slow
@pytest.mark.parametrize("method", TINY)
def test_from_packing_to_an_estimator(method, data, tmp_path, capsys):
    run, pack = tmp_path / "run", tmp_path / "pack"
    command = ["pack", str(pack), "--split", "dreds-catknown-train", "--data", str(data), "--nocs"]
    assert main([*command, "--size", str(SIDE), str(SIDE), "--engine", "serial"]) == 0
    settings = [f"{name}={value}" for name, value in TINY[method].items()]
    command = ["--method", method, "--set", *settings, "--data", str(pack), "--out", str(run)]
    command += ["--steps", "4", "--batch-size", "4", "--hold-out", "0.3", "--readers", "0"]
    assert main([*command, "--accelerator", "cpu", "--debug"]) == 0
    told = capsys.readouterr()
    assert f"--weights {run / 'best.safetensors'}" in told.out
    assert f"std-bench pose --method {method} --preset compact" in told.out
    best = json.loads((run / "best.json").read_text())
    assert best["ranked_by"] == "nocs_error"
    rows = list(csv.DictReader((run / "validation.csv").open()))
    errors = [float(row["nocs_error"]) for row in rows]
    assert best["scores"]["nocs_error"] == pytest.approx(min(errors), rel=1e-4)
    assert all(0 < error <= 0.5 for error in errors)
    assert len(list((run / "gallery").glob("step-*.jpg"))) == len(rows)
    estimator = make_pose_method(
        method,
        MethodOptions(preset="compact", weights=run / "best.safetensors", settings=TINY[method]),
    )
    assert estimator.parameter_count > 0


@pytest.mark.parametrize("method", TINY)
def test_packs_without_nocs_are_refused(method, data, tmp_path, capsys):
    pack = packed(tmp_path / "plain", data)
    settings = [f"{name}={value}" for name, value in TINY[method].items()]
    command = ["--method", method, "--set", *settings, "--data", str(pack), "--batch-size", "4"]
    command += ["--out", str(tmp_path / "run"), "--hold-out", "0.3", "--readers", "0"]
    assert main([*command, "--steps", "2", "--accelerator", "cpu"]) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert f"{pack}: the packed frames hold no NOCS" in error
    assert "--nocs" in error
    assert not (tmp_path / "run").exists()


def test_frames_are_turned_for_swindrnet_only_where_asked(pack):
    assert not plan_training(asked("swindrnet-nocs", pack))[0].geometry
    assert plan_training(asked("swindrnet-nocs", pack, geometry="on"))[0].geometry
    with pytest.raises(ToolkitError, match="geometry"):
        plan_training(asked("nocs", pack, geometry="on"))


def test_loose_and_known_pixels_do_not_depend_on_the_order_of_frames(pack):
    """The loss of a batch is that of the same frames in another order."""
    trainable = get_trainable("swindrnet-nocs")
    config, data, beginning = plan_training(asked("swindrnet-nocs", pack))
    network = make_network(trainable, config, beginning).eval()
    totals = []
    for order in ([0, 1, 2, 3], [3, 1, 0, 2]):
        seen = model_input(data.training[order])
        with torch.no_grad():
            totals.append(float(trainable.step(network, trainable.loss, seen, StepInfo()).total))
    assert np.isclose(*totals, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["swindrnet-nocs", "spd"])
def test_small_networks_are_trained_and_shipped(
    method: str, pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two steps; half-precision weights in the toolkit's folder are then used by default."""
    run = tmp_path / "run"
    words = ["--method", method, "--preset", "small", "--data", str(pack), "--out", str(run)]
    words += ["--steps", "2", "--batch-size", "2", "--hold-out", "0.3", "--readers", "0"]
    words += ["--accelerator", "cpu", "--set", f"input_size={SIDE},{SIDE}", "--copy-paste", "0.5"]
    words += ["--geometry", "on"] if method == "swindrnet-nocs" else []
    assert main(words) == 0
    state = {k: t.half() for k, t in load_file(run / "best.safetensors").items()}
    file = tmp_path / f"{method}-small.safetensors"
    save_file(state, file)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    file.with_name(f"{file.name}.sha256").write_text(f"{digest}  {file.name}\n")
    # Two such files must fit into 10 MB.
    assert file.stat().st_size < 5_500_000
    settings = {"masks": "true"} if method == "spd" else {}
    for trunk in registry.SHIPPED.glob("swindrnet-compact.safetensors*"):
        (tmp_path / trunk.name).symlink_to(trunk)
    monkeypatch.setattr(registry, "SHIPPED", tmp_path)
    preset = registry.preset_for(method, None, None)
    assert preset == "small"
    made = make_pose_method(method, MethodOptions(preset=preset, settings=settings))
    assert made.input_size is not None
