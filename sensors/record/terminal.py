"""What the user sees and says in the terminal while recording."""

from __future__ import annotations

import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

# Where the output is no terminal, one line in so many seconds instead of one that changes.
_PLAIN_EVERY_S = 5.0


class StatusLine:
    """One line that changes in place; in a file or pipe, a line now and then."""

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
    """Gives a question: was the program asked to end?

    The first Ctrl-C (or SIGTERM) asks; a second one interrupts at once. Outside the main thread,
    where signals cannot be taken, the answer is always no.
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


def enter_pressed() -> Callable[[], bool]:
    """Gives a question: has Enter been pressed since? End of input counts."""
    pressed = threading.Event()

    def read() -> None:
        sys.stdin.readline()
        pressed.set()

    threading.Thread(target=read, name="enter", daemon=True).start()
    return pressed.is_set
