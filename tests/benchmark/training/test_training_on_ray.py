"""A training over two processes of a Ray cluster that is started for it."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import pytest
import torch
from training_set import TINY, packed, trained, wishes, write_scenes

from benchmark.cli.train import main

# Ray may guard clusters by a token in the home folder; this one talks on this machine only.
os.environ["RAY_AUTH_MODE"] = "disabled"
ray = pytest.importorskip("ray", reason="needs the extra [cluster]")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("on_ray")
    return packed(top / "pack", write_scenes(top / "data"))


def command(pack: Path, run: Path, *more: str) -> list[str]:
    settings = [f"{name}={value}" for name, value in TINY["dfnet"].items()]
    return [
        "--method", "dfnet", "--set", *settings, "--data", str(pack), "--out", str(run),
        "--steps", "4", "--batch-size", "4", "--hold-out", "0.3", "--readers", "0",
        "--accelerator", "cpu", "--checkpoint-every", "2", "--log-every", "1",
        "--engine", "ray", "--devices", "2", *more,
    ]  # fmt: skip


def test_two_processes_of_a_cluster(pack, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)  # paths are taken from here, wherever the processes run
    run = tmp_path / "run"
    assert main(command(Path(os.path.relpath(pack)), Path("run"))) == 0
    told = capfd.readouterr()
    assert f"--weights {run / 'best.safetensors'}" in told.out
    assert "waiting for data" in told.err
    rows = list(csv.DictReader((run / "steps.csv").open()))
    assert [row["step"] for row in rows] == ["1", "2", "3", "4"]
    assert torch.load(run / "last.ckpt", weights_only=True)["global_step"] == 4
    assert (run / "last.safetensors").is_file()
    assert not (run / ".std" / "ray").exists()
    assert not ray.is_initialized()


@pytest.mark.long  # in short: test_clusters_that_are_not_there_or_too_small
def test_an_error_of_a_process_comes_back_as_one_line(pack, tmp_path, capfd):
    run = tmp_path / "run"
    trained(wishes("dfnet", pack, steps=1), run)
    kept = (run / "last.ckpt").read_bytes()
    assert main(command(pack, run)) == 1
    error = [line for line in capfd.readouterr().err.splitlines() if line.startswith("error")]
    assert len(error) == 1
    assert "steps: 1 then, 4 now" in error[0] and str(run) in error[0]
    assert (run / "last.ckpt").read_bytes() == kept
    assert not ray.is_initialized()


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["--ray-address", "127.0.0.1:1"], "--ray-address: no Ray cluster answers at this address"),
        (["--accelerator", "gpu"], "the cluster has 0 GPUs, which is less than the 2 processes"),
    ],
)
def test_clusters_that_are_not_there_or_too_small(more, told, pack, tmp_path, capfd):
    if "gpu" in more and torch.cuda.is_available():
        pytest.skip("this machine has GPUs")
    assert main(command(pack, tmp_path / "run", *more)) == 1
    assert told in capfd.readouterr().err
