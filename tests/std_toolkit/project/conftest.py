from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.std_toolkit.project.lab import template

# Runs a command and kills the process as `kill -9` does when it is about to move its n-th file or
# folder to its place.
KILLED = """
import os, pathlib, signal, sys
left = int(sys.argv[1])
def dying(move):
    def moved(self, target):
        global left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return move(self, target)
    return moved
pathlib.Path.replace = dying(pathlib.Path.replace)
pathlib.Path.rename = dying(pathlib.Path.rename)
from std_toolkit.cli.main import main
sys.exit(main(["--quiet", *sys.argv[2:]]))
"""


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """See `lab.template`."""
    return template(tmp_path_factory.mktemp("lab") / "template")


@pytest.fixture
def killed_at() -> Callable[[int, list[str]], int]:
    """Runs `std-curate` in a process that is killed at its n-th move; returns the status."""

    def run(moves: int, words: list[str]) -> int:
        done = subprocess.run(
            [sys.executable, "-c", KILLED, str(moves), *words],
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            capture_output=True,
            timeout=300,
        )
        return done.returncode

    return run
