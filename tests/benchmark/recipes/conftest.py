"""Nothing here runs without torch, which only the extra `train` brings."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

import pytest

from std_toolkit.log import logger

collect_ignore_glob = [] if find_spec("torch") else ["test_*.py"]


@pytest.fixture(autouse=True)
def no_log_of_an_ended_test() -> Iterator[None]:
    """A command's log goes to its test's stderr, which is closed afterwards."""
    yield
    logger.handlers.clear()
    logger.propagate = True
