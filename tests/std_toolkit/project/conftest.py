from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.std_toolkit.project.lab import template

# Runs a command and kills the process as `kill -9` does when it is about to move the first file or
# folder to a path with some text in it.
KILLED = """
import os, pathlib, signal, sys
def dying(move):
    def moved(self, target):
        if sys.argv[1] in str(target):
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
def killed_at() -> Callable[[str, list[str]], int]:
    """Runs `std-curate` in a process that is killed before a file is moved to its place.

    Takes a part of the path of that file, and the words; returns the status.
    """

    def run(path: str, words: list[str]) -> int:
        done = subprocess.run(
            [sys.executable, "-c", KILLED, path, *words],
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            capture_output=True,
            timeout=300,
        )
        return done.returncode

    return run


@pytest.fixture
def opened_files() -> Iterator[Callable[[], list[str]]]:
    """Returns the files that were opened since it was called last, but for locks and folders."""
    found: list[str] = []
    watching = [True]

    def hear(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and watching and isinstance(arguments[0], str | os.PathLike):
            found.append(os.fspath(arguments[0]))

    def since() -> list[str]:
        told = [path for path in found if not path.endswith("lock") and not Path(path).is_dir()]
        found.clear()
        return told

    sys.addaudithook(hear)  # which cannot be removed
    yield since
    watching.clear()
