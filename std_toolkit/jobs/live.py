"""Interface of a program that runs until it is stopped: status line and stop by signal."""

import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

# Interval of status lines if the output is not a terminal.
_PLAIN_EVERY_S = 5.0


class StatusLine:
    """One line updated in place; in a file or pipe, a line at intervals."""

    def __init__(self) -> None:
        self._changing = sys.stderr.isatty()
        self._last = float("-inf")

    def show(self, text: str) -> None:
        if self._changing:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r{text[:width]:<{width}}", end="", file=sys.stderr, flush=True)
        elif time.monotonic() - self._last >= _PLAIN_EVERY_S:
            self._last = time.monotonic()
            print(text, file=sys.stderr, flush=True)

    def end(self) -> None:
        if self._changing:
            print(file=sys.stderr)


@contextmanager
def stopped_by_signal() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether the program was asked to stop.

    The first Ctrl-C (or SIGTERM) requests the stop; a second one interrupts at once. Outside the
    main thread, where signals cannot be handled, the function always returns False.
    """
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return

    def handle(_number: int, _frame: FrameType | None) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()

    before = {n: signal.signal(n, handle) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
