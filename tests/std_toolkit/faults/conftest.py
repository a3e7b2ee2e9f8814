"""A scene that is copied for every case, and the command line run in this process."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from scene_on_disk import contents, write_scene

from std_toolkit.cli.main import main


@dataclass(frozen=True)
class Outcome:
    """What a command did."""

    status: int
    out: str
    err: str

    @property
    def error_lines(self) -> list[str]:
        return [line for line in self.err.splitlines() if line.startswith("error:")]


@pytest.fixture(scope="session")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A labelled scene with rendered ground truth; never changed."""
    root = tmp_path_factory.mktemp("pristine") / "scene"
    write_scene(root)
    assert main(["--quiet", "propagate", str(root)]) == 0
    assert main(["--quiet", "render", str(root), "--renderer", "raycast"]) == 0
    return root


@pytest.fixture
def root(pristine: Path, tmp_path: Path) -> Path:
    """A copy of the scene, to be damaged."""
    return Path(shutil.copytree(pristine, tmp_path / "scene"))


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Run `std-curate` with these arguments; also catches what libraries print by themselves."""

    def run_command(*arguments: object) -> Outcome:
        capfd.readouterr()
        status = main([str(a) for a in arguments])
        out, err = capfd.readouterr()
        return Outcome(status, out, err)

    return run_command


@pytest.fixture
def refuse(root: Path, run: Callable[..., Outcome]) -> Callable[..., str]:
    """Assert that a command refuses the scene with one line and changes nothing in it."""

    def assert_refused(*arguments: object, names: str) -> str:
        before = contents(root)
        outcome = run(*arguments)
        assert outcome.status == 1, f"exit status {outcome.status}; {outcome.out}{outcome.err}"
        assert len(outcome.error_lines) == 1, outcome.err
        line = outcome.error_lines[0]
        assert "Traceback" not in outcome.err + outcome.out
        assert "a defect of" not in line, line
        assert names in line, line
        assert line.isprintable()
        assert len(line) < 1500
        assert contents(root) == before
        return line

    return assert_refused
