"""However the work is spread, and whoever dies, the set is the same in the end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from set_on_disk import arguments as set_arguments
from set_on_disk import contents

from sensors.output.dreds import scene_folder
from sensors.simulation.cli import main

# Ray may guard clusters by a token in the home folder; the one here talks on this machine only.
os.environ["RAY_AUTH_MODE"] = "disabled"
pytestmark = pytest.mark.slow
SCENES = 2


def arguments(out: Path, shapes: Path, *more: str) -> list[str]:
    some = ("--scenes", str(SCENES), "--layout", "dreds", "--layout", "scene")
    return set_arguments(out, shapes, *some, *more)


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory, shapes: Path) -> dict[str, str]:
    """The set as one process makes it."""
    out = tmp_path_factory.mktemp("set") / "serial"
    assert main(arguments(out, shapes, "--engine", "serial")) == 0
    return contents(out)


def children(process: int) -> list[int]:
    """Ids of the processes that it started and that still run."""
    listed = Path(f"/proc/{process}/task/{process}/children")
    try:
        return [int(number) for number in listed.read_text().split()]
    except FileNotFoundError:
        return []


def test_a_ray_cluster_makes_the_same_set(
    reference: dict[str, str], shapes: Path, tmp_path: Path
) -> None:
    pytest.importorskip("ray", reason="needs the extra [cluster]")
    out = tmp_path / "ray"
    assert main(arguments(out, shapes, "--engine", "ray", "--workers", "2")) == 0
    assert contents(out) == reference


@pytest.mark.parametrize(
    "how", [signal.SIGKILL, pytest.param(signal.SIGABRT, marks=pytest.mark.long)]
)
def test_killed_workers_lose_nothing(
    how: signal.Signals, reference: dict[str, str], shapes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "sensors.simulation.cli"]
    command += arguments(out, shapes, "--workers", "2")
    run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 400
    while not any((out / ".partial").rglob("*_meta.txt")):
        assert run.poll() is None and time.monotonic() < end
        time.sleep(0.01)
    # Workers are children of the server that forks them.
    victims = [w for server in children(run.pid) for w in children(server)]
    assert len(victims) == 2
    for worker in victims:
        os.kill(worker, how)
    _, said = run.communicate(timeout=400)
    assert run.returncode == 0, said
    assert {scene_folder(out, "train", f"{i:05d}").is_dir() for i in range(SCENES)} == {True}
    assert not (out / ".partial").exists() or not any((out / ".partial").iterdir())
    assert contents(out) == reference
