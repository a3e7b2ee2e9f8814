"""A training of two processes whose machine dies goes on to the same weights."""

from __future__ import annotations

import csv
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from safetensors.torch import load_file
from training_set import TINY, packed, same, write_scenes

from benchmark.training.run_files import CHECKPOINT
from std_toolkit.jobs.guard import children_of

pytestmark = pytest.mark.long
_LONGEST = float(os.environ.get("STD_TEST_PATIENCE", "100"))  # seconds; a busy machine needs more


def command_of(pack: Path, run: Path) -> list[str]:
    """LIDF, which changes what learns in the middle: two steps of each phase."""
    settings = [f"{name}={value}" for name, value in TINY["lidf"].items()]
    return [
        sys.executable, "-m", "benchmark.cli.train", "--method", "lidf", "--set", *settings,
        "--data", str(pack), "--out", str(run), "--batch-size", "4", "--hold-out", "0.3",
        "--phases", "coarse=2", "refine=2", "hard=2", "--readers", "0", "--accelerator", "cpu",
        "--devices", "2", "--checkpoint-every", "1", "--validate-every", "6", "--log-every", "1",
    ]  # fmt: skip


def started(pack: Path, run: Path, said: Path) -> list[subprocess.Popen[bytes]]:
    """Both processes of a training, with the environment that torchrun gives them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = command_of(pack, run)
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


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_both_in_time(number, tmp_path):
    """One that waits for the other keeps the interpreter's lock: no handler and no thread runs."""
    pack, run = packed(tmp_path / "pack", write_scenes(tmp_path / "data")), tmp_path / "run"
    # Enough steps that the signal comes in the middle.
    command = [w.replace("hard=2", "hard=500") for w in command_of(pack, run)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + _LONGEST
    while not (run / CHECKPOINT).exists():
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.05)
    both = children_of(process.pid)
    assert len(both) >= 2  # the other one, and the guard
    began = time.monotonic()
    process.send_signal(number)
    said = process.communicate(timeout=60)[1]
    assert time.monotonic() - began < 5
    assert "interrupted; run the same command again to resume" in said.splitlines()
    left = [child for child in both if Path(f"/proc/{child}/cmdline").exists()]
    assert not [child for child in left if Path(f"/proc/{child}/cmdline").read_bytes()]
    assert (run / CHECKPOINT).exists()
