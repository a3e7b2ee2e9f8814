"""The command line's log."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from std_toolkit.log import log_to_stderr, logger


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
