"""The toolkit's one logger. Libraries log to it; only the command line gives it a handler."""

from __future__ import annotations

import logging
import sys

logger = logging.getLogger("std_toolkit")


def log_to_stderr(level: int = logging.INFO) -> None:
    """Print log records of `level` and above to stderr, as the command-line tools do."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    logger.handlers[:] = [handler]
    logger.setLevel(level)
    logger.propagate = False
