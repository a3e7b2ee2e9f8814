"""A training of two processes whose machine dies goes on to the same weights."""

from __future__ import annotations

import csv
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from safetensors.torch import load_file
from training_set import TINY, packed, same, write_scenes

from benchmark.training.run_files import CHECKPOINT

pytestmark = pytest.mark.slow
_LONGEST = float(os.environ.get("STD_TEST_PATIENCE", "100"))  # seconds; a busy machine needs more


def started(pack: Path, run: Path, said: Path) -> list[subprocess.Popen[bytes]]:
    """Both processes of a training, with the environment that torchrun gives them.

    LIDF, which changes what learns in the middle: two steps of the first stage, then of the second.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = [f"{name}={value}" for name, value in TINY["lidf"].items()]
    command = [
        sys.executable, "-m", "benchmark.cli.train", "--method", "lidf", "--set", *settings,
        "--data", str(pack), "--out", str(run), "--batch-size", "4", "--hold-out", "0.3",
        "--phases", "coarse=2", "refine=2", "hard=2", "--readers", "0", "--accelerator", "cpu",
        "--devices", "2", "--checkpoint-every", "1", "--validate-every", "6", "--log-every", "1",
    ]  # fmt: skip
    both = {
        "OMP_NUM_THREADS": "1", "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2", "GROUP_RANK": "0",
        "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "TORCHELASTIC_RUN_ID": "test",
    }  # fmt: skip
    processes = []
    for rank in "01":
        own = both | {"RANK": rank, "LOCAL_RANK": rank}
        with said.with_suffix(f".{rank}").open("wb") as file:
            processes.append(
                subprocess.Popen(command, env=os.environ | own, stdout=file, stderr=file)
            )
    return processes


def killed(processes: list[subprocess.Popen[bytes]]) -> list[int]:
    for process in processes:
        process.kill()
    return [process.wait(timeout=60) for process in processes]


def told(said: Path) -> str:
    return "\n".join(said.with_suffix(f".{rank}").read_text() for rank in "01")


def ended(processes: list[subprocess.Popen[bytes]], said: Path) -> None:
    """Wait for their good end; whatever was started ends with the test."""
    end = time.monotonic() + _LONGEST
    try:
        codes = [p.wait(timeout=max(0.0, end - time.monotonic())) for p in processes]
    finally:
        killed(processes)
    assert codes == [0, 0], told(said)[-3000:]


def test_both_killed_and_started_again(tmp_path):
    pack = packed(tmp_path / "pack", write_scenes(tmp_path / "data"))
    whole, parted, said = tmp_path / "whole", tmp_path / "parted", tmp_path / "said"
    ended(started(pack, whole, said), said)
    assert "samples/s" in told(said) and "waiting for data" in told(said)

    checkpoint, processes = parted / CHECKPOINT, started(pack, parted, said)
    written: set[int] = set()
    while all(p.poll() is None for p in processes) and len(written) < 2:
        time.sleep(0.002)
        if checkpoint.exists():
            written.add(checkpoint.stat().st_mtime_ns)
    assert killed(processes) == [-9, -9], told(said)[-3000:]
    assert not (parted / "last.safetensors").exists()

    ended(started(pack, parted, said), said)
    assert "going on from step" in told(said)
    assert same(load_file(whole / "last.safetensors"), load_file(parted / "last.safetensors"))
    logs = [list(csv.DictReader((run / "steps.csv").open())) for run in (whole, parted)]
    steps = [[(row["step"], row["phase"], row["loss"]) for row in rows] for rows in logs]
    assert steps[0] == steps[1]
    assert [row[1] for row in steps[0]] == ["coarse"] * 2 + ["refine"] * 2 + ["hard"] * 2
