"""The toolkit's logger. Modules log to it; only the command line adds a handler."""

import io
import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

logger = logging.getLogger("std_toolkit")


def log_to_stderr(level: int = logging.INFO) -> None:
    """Print log records of `level` and above to stderr, as the command-line tools do.

    A warning is printed once: many steps of a command may read the same file.
    """
    handler = _StderrHandler()
    handler.addFilter(_NewWarnings())
    handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    logger.handlers[:] = [handler]
    logger.setLevel(level)
    logger.propagate = False
    # It prints the traceback of a texture that it cannot read, and goes on without.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)


def escape_what_cannot_be_encoded() -> None:
    """Let stdout and stderr escape characters that their encoding lacks, instead of failing.

    Names of files may have any character; pipes and old terminals may have latin-1 or ASCII.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors != "backslashreplace":
            stream.reconfigure(errors="backslashreplace")


class _NewWarnings(logging.Filter):
    """Drops warnings that were printed before."""

    def __init__(self) -> None:
        super().__init__()
        self._printed: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        if record.levelno != logging.WARNING:
            return True
        message = record.getMessage()
        if message in self._printed:
            return False
        self._printed.add(message)
        return True


class _StderrHandler(logging.StreamHandler):
    """Writes to the current `sys.stderr`, which may have been replaced."""

    def __init__(self) -> None:
        logging.Handler.__init__(self)

    @property
    def stream(self) -> TextIO:
        return sys.stderr


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """A list of the warnings that this thread logs within the block, for callers without stderr.

    The warnings are still logged.
    """
    said: list[str] = []
    here = threading.get_ident()

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread == here:
                said.append(record.getMessage())

    collector = Collector(logging.WARNING)
    logger.addHandler(collector)
    try:
        yield said
    finally:
        logger.removeHandler(collector)
