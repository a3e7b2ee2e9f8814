"""Trainings from end to end: what they leave behind, and that they learn."""

from __future__ import annotations

import csv
import itertools
import json
import math
import os
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from training_set import LARGE, SIDE, SPLIT, TINY, packed, same, trained, wishes, write_scenes

from benchmark.cli.bench import main as bench
from benchmark.cli.train import main
from benchmark.data.splits import open_split
from benchmark.methods.depth.full_size import view_of
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.training.catalogue import get_trainable
from benchmark.training.fit import Beginning, make_network
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.plan import plan_training
from benchmark.training.step import StepInfo, depth_step, model_input
from benchmark.training.validation import SUBSETS, DepthValidator, main_score, scores_of
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import read_color


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("fit_data"))


@pytest.fixture(scope="module")
def pack(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return packed(tmp_path_factory.mktemp("fit") / "pack", data)


def options(method: str) -> list[str]:
    settings = [f"{name}={value}" for name, value in TINY[method].items()]
    return ["--method", method, "--preset", "compact", "--set", *settings]


@pytest.mark.slow
@pytest.mark.parametrize("method", TINY)
def test_from_packing_to_the_leaderboard(method, data, tmp_path, capsys):
    """The commands one after the other; the scores of training are those of the restorer."""
    run, pack = tmp_path / "run", tmp_path / "pack"
    command = ["pack", str(pack), "--split", SPLIT, "--data", str(data), "--engine", "serial"]
    assert main([*command, "--size", str(SIDE), str(SIDE), "--color", "area"]) == 0
    command = [*options(method), "--data", str(pack), "--out", str(run), "--steps", "4"]
    command += ["--batch-size", "4", "--hold-out", "0.3", "--readers", "0", "--accelerator", "cpu"]
    assert main([*command, "--debug"]) == 0
    told = capsys.readouterr()
    assert f"--weights {run / 'best.safetensors'}" in told.out
    assert "samples/s" in told.err
    assert "waiting for data" in told.err
    best = json.loads((run / "best.json").read_text())
    rows = list(csv.DictReader((run / "validation.csv").open()))
    ranked = "loss" if method == "cleargrasp" else "ranked_rmse"
    scores = [float(row[ranked]) for row in rows]
    assert best["ranked_by"] == ranked
    assert best["scores"][ranked] == pytest.approx(min(scores), rel=1e-4)
    assert len(list((run / "gallery").glob("step-*.jpg"))) == len(rows)
    assert list((run / "tensorboard").glob("events*"))

    weights = ["--weights", str(run / "best.safetensors")]
    results = ["--data", str(data), "--split", SPLIT, "--out", str(tmp_path / "results")]
    quick = ["--no-speed", "--no-gallery", "--workers", "1"]
    assert bench([*options(method), *weights, *results, *quick]) == 0

    made = MethodOptions(preset="compact", weights=run / "best.safetensors", settings=TINY[method])
    restorer, source = make_restorer(method, made), open_split(SPLIT, data)
    if ranked == "loss":
        return  # its depth is that of the optimisation, which validation leaves out
    frames = PackedFrames([pack])
    config, found, _ = plan_training(
        replace(wishes(method, pack), hold_out=0.3, settings=TINY[method])
    )
    answers = [
        restorer.restore([view_of(source.load(i), (SIDE, SIDE), with_mask=restorer.needs_mask)])[
            0
        ].depth
        for i in found.of_validation
    ]
    from benchmark.metrics.depth.accumulate import DepthMetrics

    metrics = DepthMetrics()
    for i, answer in zip(found.of_validation, answers, strict=True):
        frame = frames.frame(i)
        hard = frame.mask_where(lambda x: x.material in (2, 3)) & (frame.depth_true > 0)
        metrics.update(answer, frame.depth_true, hard)
    assert metrics.compute()["rmse"] == pytest.approx(
        best["scores"]["specular_transparent_rmse"], rel=1e-4
    )
    assert config.method == method


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", [pytest.param(m, marks=pytest.mark.long if m in LARGE else []) for m in TINY]
)
def test_training_learns(method, pack, tmp_path):
    """Nine frames by heart: the loss falls to less than half."""
    settings, rate = dict(TINY[method]), 3e-3
    if method in ("swindrnet", "two-branch"):
        settings, rate = settings | {"drop_path": "0", "dropout": "0"}, 1e-2
    if method in ("cleargrasp", "compactdr"):
        rate = 1e-2
    asked = wishes(
        method, pack, settings=settings, steps=80, learning_rate=rate, colors="off",
        geometry="off", checkpoint_every=40, validate_every=40,
    )  # fmt: skip
    if phase := {"lidf": "coarse", "compactdr": "mask"}.get(method):
        asked = replace(asked, steps=None, phases={phase: 80})
    trained(asked, tmp_path)
    losses = [float(row["loss"]) for row in csv.DictReader((tmp_path / "steps.csv").open())]
    assert np.mean(losses[-5:]) < 0.5 * np.mean(losses[:2]), losses


@pytest.mark.parametrize("method", TINY)
def test_every_parameter_receives_a_gradient(method, pack):
    config, data, beginning = plan_training(wishes(method, pack))
    trainable = get_trainable(method)
    network = make_network(trainable, config, beginning).train()
    optimizer = config.optimization.make(network)
    moved = {name: torch.zeros_like(p) for name, p in network.named_parameters()}
    # What begins at 0 holds up the gradients of what is behind it: several steps.
    for step, phase in itertools.product(range(4), config.phases or [""]):
        batch = data.training[[0, 1, 2, step + 3]]
        optimizer.zero_grad()
        step_info = StepInfo(phase, step, 4)
        trainable.step(network, trainable.loss, model_input(batch), step_info).total.backward()
        optimizer.step()
        for name, parameter in network.named_parameters():
            assert parameter.grad is not None or config.phases, name
            if parameter.grad is not None:
                moved[name] += parameter.grad.abs()
    assert [name for name, total in moved.items() if not total.any()] == []


def test_released_fusion_leaves_its_attention_without_gradient(pack):
    settings = {**TINY["swindrnet"], "fusion": "released"}
    config, data, beginning = plan_training(wishes("swindrnet", pack, settings=settings))
    trainable = get_trainable("swindrnet")
    network = make_network(trainable, config, beginning).train()
    batch = data.training[[0, 1]]
    depth_step(network, trainable.loss, model_input(batch), StepInfo()).total.backward()
    idle = {name for name, p in network.named_parameters() if p.grad is None}
    assert idle
    # What makes queries, keys and values of depth, and nothing else.
    assert all(".attn." in name or ".norm1_branch_2." in name for name in idle)
    assert all(name.startswith("cross_attention_") for name in idle)
    assert trainable.idle(network.config)


def test_published_preset_trains_the_fusion_of_the_paper():
    trainable = get_trainable("swindrnet")
    assert trainable.settings_of("published", {}) == {"fusion": "paper"}
    assert trainable.settings_of("published", {"fusion": "released"}) == {"fusion": "released"}
    assert trainable.config("compact", {}).fusion == "paper"


@pytest.mark.slow
def test_parts_of_a_step_add_up(pack, tmp_path):
    """Four parts accumulated are the mean of their four gradients; checked by a step of SGD-like
    Adam: the weights differ from a whole batch's only through batch normalisation."""
    one = trained(wishes("dfnet", pack, steps=1), tmp_path / "one")
    two = trained(wishes("dfnet", pack, steps=1, accumulate=2), tmp_path / "two")
    assert not same(one, two)
    moved = [(one[name] - two[name]).abs().max().item() for name in one if "weight" in name]
    assert max(moved) < 2.5e-3  # both moved by the learning rate, 1e-3, at most


@pytest.mark.slow
def test_bf16_trains_and_keeps_weights_in_full(pack, tmp_path):
    weights = trained(wishes("swindrnet", pack, precision="bf16"), tmp_path)
    assert {t.dtype for t in weights.values() if t.is_floating_point()} == {torch.float32}
    assert all(torch.isfinite(t).all() for t in weights.values())


@pytest.mark.slow
def test_training_begins_with_given_weights(pack, tmp_path):
    first = trained(wishes("dfnet", pack, steps=2), tmp_path / "first")
    file = tmp_path / "first" / "last.safetensors"
    config, _, beginning = plan_training(wishes("dfnet", pack, weights=file))
    assert config.beginning.startswith("weights ")
    network = make_network(get_trainable("dfnet"), config, beginning)
    assert same(first, network.state_dict())
    with pytest.raises(ToolkitError, match="does not begin with a classifier's weights"):
        make_network(get_trainable("dfnet"), config, Beginning(imagenet=file))


def test_wrong_weights_leave_no_training_behind(pack, tmp_path):
    torch.save({"other.weight": torch.ones(2)}, tmp_path / "other.pth")
    with pytest.raises(ToolkitError, match="weights of another network"):
        trained(wishes("dfnet", pack, steps=2, weights=tmp_path / "other.pth"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_two_processes_share_a_training(pack, tmp_path):
    """Launched as torchrun does, on gloo; their weights agree and the run goes on as one."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    run = tmp_path / "run"
    command = [
        sys.executable, "-m", "torch.distributed.run", "--nproc_per_node", "2",
        "--master_port", str(port), "-m", "benchmark.cli.train", *options("swindrnet"),
        "--data", str(pack), "--out", str(run), "--steps", "4", "--batch-size", "4",
        "--hold-out", "0.3", "--readers", "0", "--accelerator", "cpu", "--devices", "2",
        "--checkpoint-every", "2", "--log-every", "1",
    ]  # fmt: skip
    done = subprocess.run(
        command, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, timeout=110
    )
    assert done.returncode == 0, done.stderr.decode()[-3000:]
    assert (run / "best.safetensors").is_file()
    rows = list(csv.DictReader((run / "steps.csv").open()))
    assert [row["step"] for row in rows] == ["1", "2", "3", "4"]
    assert torch.load(run / "last.ckpt", weights_only=True)["global_step"] == 4


def test_shares_of_validation_add_up_to_the_whole(pack):
    frames = PackedFrames([pack])
    validator = DepthValidator(frames, range(7), 2)
    network = make_network(
        get_trainable("dfnet"), plan_training(wishes("dfnet", pack))[0], Beginning()
    )
    device = torch.device("cpu")
    whole = validator.states(network, device)
    parts = [validator.states(network, device, rank=rank, world=3) for rank in range(3)]
    assert np.allclose(sum(parts), whole)
    assert network.training, "it is left as it was"
    name, value = main_score(scores_of(whole))
    scores = scores_of(whole)
    assert name == "ranked_rmse"
    assert value >= scores["specular_transparent_rmse"] > 0
    assert 0 <= scores["harm_opaque"] <= 1
    assert scores["holes"] > 0 and scores["holes_nearest"] > 0


def test_swelling_costs_more_than_it_gains():
    """RMSE counts as it is within the bars, and times their excess beyond."""
    scores = {f"{name}_rmse": math.nan for name in SUBSETS} | {
        "specular_transparent_rmse": 0.03,
        "harm_opaque": 0.004,
        "harm_background": math.nan,
        "harm_band": 0.01,
        "holes": 0.014,
        "holes_nearest": 0.01,
    }
    assert main_score(scores) == ("ranked_rmse", 0.03)
    assert main_score(scores | {"harm_band": 0.04})[1] == pytest.approx(0.12)
    assert main_score(scores | {"holes": 0.06})[1] == pytest.approx(0.12)
    unknown = {"holes": math.nan, "holes_nearest": math.nan, "harm_band": math.nan}
    assert main_score(scores | unknown)[1] == 0.03
    nothing = dict.fromkeys(scores, math.nan)
    assert main_score(nothing)[1] == math.inf


def test_pictures_show_the_frames(pack, tmp_path):
    frames = PackedFrames([pack])
    network = make_network(
        get_trainable("dfnet"), plan_training(wishes("dfnet", pack))[0], Beginning()
    )
    DepthValidator(frames, range(2), 2).gallery(network, torch.device("cpu"), tmp_path / "g.jpg")
    picture = read_color(tmp_path / "g.jpg")
    assert picture.shape[0] == 2 * 320
    assert picture.std() > 10


def test_log_rows_beyond_the_checkpoint_are_dropped(tmp_path):
    from benchmark.training.run_files import Rows

    rows = Rows(tmp_path / "log.csv", 0)
    for step in (1, 2, 3):
        rows.add({"step": step, "loss": step / 3})
    rows.save()
    again = Rows(tmp_path / "log.csv", 2)
    again.add({"step": 3, "loss": 0.5, "more": 1})
    again.save()
    assert (tmp_path / "log.csv").read_text() == (
        "step,loss,more\n1,0.333333,\n2,0.666667,\n3,0.5,1\n"
    )


def test_waiting_for_data_is_told(monkeypatch):
    from benchmark.training import run_files

    clock = iter([0.0, 3.0, 4.0, 10.0, 10.5, 12.0])
    monkeypatch.setattr(run_files.time, "perf_counter", lambda: next(clock))
    speed = run_files.Speed()
    speed.begin_step()  # 3 s for data
    speed.end_step(8)  # 1 s of work
    speed.restart()  # 6 s of validation
    speed.begin_step()  # 0.5 s for data
    speed.end_step(8)  # 1.5 s of work
    assert speed.figures() == {"samples_per_s": 16 / 6, "waiting_for_data": 3.5 / 6}


@pytest.mark.parametrize(
    ("arguments", "told", "status"),
    [
        ("--method dfnet", "--out, --data: needed", 2),
        ("--method dfnet --data x --out y --loss a", "--loss: expected NAME=VALUE", 2),
        (
            "--method dfnet --data x --out y --object-dropout 2",
            "--object-dropout: must be at most 1 (got 2.0)",
            2,
        ),
        ("--method dfnet --data nowhere --out y", "no folder of packed frames", 1),
        ("pack p --split nonsense --data .", "no plug-in with this name", 1),
        ("pack p --split x --data . --size 0 3", "--size: must be at least 1 (got (0, 3))", 2),
        ("pack p --split x --data . --size 3", "--size: expected INT INT", 2),
        ("recipe data-scale --scale huge", "no such scale", 1),
    ],
)
def test_command_tells_what_is_wrong_in_one_line(
    arguments, told, status, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(arguments.split()) == status
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert told in error[0]


def test_help_needs_no_heavy_library():
    code = (
        "import sys\nfrom benchmark.cli.train import PROGRAM, main\n"
        "for command in PROGRAM.commands:\n"
        "    try:\n        main([command.name, '--help'])\n    except SystemExit:\n        pass\n"
        "assert not {'torch', 'numpy', 'pytorch_lightning', 'cv2'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
