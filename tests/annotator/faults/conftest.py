"""A scene that may be damaged, and `std-annotate` run on it in this process."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hostile_annotation import Annotate, Outcome, Refuse, documents
from scene_on_disk import write_scene

from annotator.cli import main


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A scene with three registered frames, a labelled box and a wall behind it."""
    return write_scene(tmp_path / "scene").root


@pytest.fixture
def annotate(root: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Annotate:
    """Run `std-annotate SCENE --script FILE`; the steps are JSON values, or text as it is."""

    def run(steps: Any, *arguments: str, scene: Path = root) -> Outcome:
        path = tmp_path / "script.json"
        path.write_text(steps if isinstance(steps, str) else json.dumps(steps))
        capfd.readouterr()
        status = main([str(scene), "--script", str(path), "--annotator", "mk", *arguments])
        out, err = capfd.readouterr()
        return Outcome(status, out, err)

    return run


@pytest.fixture
def refuse(root: Path, annotate: Annotate) -> Refuse:
    """Assert that a script is refused with one line and leaves the scene as it was."""

    def refused(steps: Any, *arguments: str, names: str, scene: Path = root) -> str:
        before = documents(scene)
        outcome = annotate(steps, *arguments, scene=scene)
        assert outcome.status == 1, f"exit status {outcome.status}; {outcome.out}{outcome.err}"
        assert len(outcome.error_lines) == 1, outcome.err
        line = outcome.error_lines[0]
        assert "Traceback" not in outcome.err + outcome.out
        assert "a defect of" not in line, line
        assert names in line, line
        assert line.isprintable()
        assert len(line) < 1500
        assert documents(scene) == before
        return line

    return refused
