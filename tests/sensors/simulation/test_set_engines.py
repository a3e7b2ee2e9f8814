"""However the work is spread, and whoever dies, the set is the same in the end."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trimesh

from sensors.output.dreds import scene_folder
from sensors.simulation.cli import main

# Ray may guard clusters by a token in the home folder; the one here talks on this machine only.
os.environ["RAY_AUTH_MODE"] = "disabled"
pytestmark = pytest.mark.slow
SCENES = 3


@pytest.fixture(scope="module")
def shapes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Convex meshes, which cost no decomposition."""
    folder = tmp_path_factory.mktemp("shapes")
    for name, mesh in {
        "box/small.obj": trimesh.creation.box((0.1, 0.06, 0.08)),
        "ball/plain.obj": trimesh.creation.icosphere(3, 0.05),
    }.items():
        (folder / name).parent.mkdir(exist_ok=True)
        mesh.export(folder / name)
    return folder


def arguments(out: Path, shapes: Path, *more: str) -> list[str]:
    return [
        *("--out", str(out), "--assets", "folder", "--assets-root", str(shapes)),
        *("--preset", "tiny", "--width", "160", "--height", "90", "--views", "2"),
        *("--scenes", str(SCENES), "--layout", "dreds", "--layout", "scene"),
        *more,
    ]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory, shapes: Path) -> dict[str, str]:
    """The set as one process makes it."""
    out = tmp_path_factory.mktemp("set") / "serial"
    assert main(arguments(out, shapes, "--engine", "serial")) == 0
    return contents(out)


def contents(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


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
