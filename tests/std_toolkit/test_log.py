"""The command line's log."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from std_toolkit.log import log_to_stderr, logger
from tests.scene_on_disk import write_scene


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    handlers, level, propagate = logger.handlers[:], logger.level, logger.propagate
    yield
    logger.handlers[:] = handlers
    logger.setLevel(level)
    logger.propagate = propagate


def test_a_warning_is_printed_once(capsys: pytest.CaptureFixture[str]) -> None:
    log_to_stderr()
    for _ in range(2):
        logger.warning("%s: no depth", "a.png")
        logger.warning("%s: no depth", "b.png")
        logger.info("going on")
        logger.error("failed")
    lines = capsys.readouterr().err.splitlines()
    assert lines.count("WARNING: a.png: no depth") == lines.count("WARNING: b.png: no depth") == 1
    assert lines.count("INFO: going on") == lines.count("ERROR: failed") == 2
    log_to_stderr(logging.WARNING)  # another command
    logger.warning("%s: no depth", "a.png")
    assert capsys.readouterr().err == "WARNING: a.png: no depth\n"


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "cp1252", "utf-8"])
def test_names_that_the_terminal_cannot_show_are_escaped(encoding: str, tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "\u0441\u0446\u0435\u043d\u0430 \u676f").root
    for words in (["info", str(scene)], ["info", str(scene / "no such")], ["--help"]):
        done = subprocess.run(
            [sys.executable, "-m", "std_toolkit.cli.programs", "std-curate", *words],
            env={**os.environ, "PYTHONIOENCODING": encoding},
            capture_output=True,
            check=False,
        )
        assert done.returncode == (1 if "no such" in words[-1] else 0)
        assert b"Encode" not in done.stderr
        shown = "\u0441\u0446".encode(encoding, "backslashreplace")
        assert words == ["--help"] or shown in done.stdout + done.stderr
