"""SIGINT and SIGTERM end a program within seconds, whatever it computes.

Python runs a handler when the interpreter has control again. A mapper or a training step may keep
it for minutes. A thread therefore ends the process if it still runs some seconds after the signal.
Every file is written atomically, so that this loses only the item in work.
"""

from __future__ import annotations

import os
import select
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

GRACE_S = 3.0
"""Seconds from a signal until the process is ended from outside the computation."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# A main thread that has ended waits for other threads, such as those of a pool.
_LEAVING_S = 30.0


@contextmanager
def ended_by_signals(message: str, *, grace_s: float | None = GRACE_S) -> Iterator[list[int]]:
    """SIGTERM interrupts the block as SIGINT does; the process ends in `grace_s` in any case.

    Outside the main thread, where signals cannot be handled, the block runs as it is.

    Args:
        message: line on stderr if the process is ended from outside the computation.
        grace_s: None to wait as long as the block takes.

    Yields:
        A list that SIGTERM adds its number to.
    """
    terminated: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield terminated
        return
    reading, writing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    woken = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)

    def terminate(number: int, frame: FrameType | None) -> None:
        terminated.append(number)
        _interrupt(number, frame)

    before = signal.signal(signal.SIGTERM, terminate)
    over = threading.Event()
    threading.Thread(
        target=_watch, args=(reading, over, message, grace_s), name="signals", daemon=True
    ).start()
    try:
        yield terminated
    finally:
        over.set()
        signal.signal(signal.SIGTERM, before)
        signal.set_wakeup_fd(woken)
        os.close(writing)  # the thread ends at the end of its input


def keep_handlers() -> None:
    """Install Python's handlers again after the import of a library that replaced them.

    The log library within pycolmap prints a stack trace at SIGTERM and ends the process.
    """
    if threading.current_thread() is threading.main_thread():
        for number in _SIGNALS:
            handler = signal.getsignal(number)
            if callable(handler):
                signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Do what SIGINT does here: a window closes, a server stops, a computation is interrupted."""
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(number, frame)
    else:  # SIGINT is ignored, as in the background of a script
        raise KeyboardInterrupt


def _watch(reading: int, over: threading.Event, message: str, grace_s: float | None) -> None:
    number = _first_signal(reading)
    if number is None or grace_s is None:
        return
    end = time.monotonic() + grace_s
    while time.monotonic() < end and not over.is_set():
        time.sleep(0.05)
    if over.is_set():
        # The program is leaving; it may still wait for threads.
        end = time.monotonic() + _LEAVING_S
        while threading.main_thread().is_alive() and time.monotonic() < end:
            time.sleep(0.05)
        if threading.main_thread().is_alive():
            return  # `main` was called by another program, which goes on
        time.sleep(1.0)
    else:
        os.write(2, f"{message}\n".encode())
    for child in _children():
        with suppress(OSError):
            os.kill(child, signal.SIGKILL)
    os._exit(128 + number)


def _first_signal(reading: int) -> int | None:
    """The first signal to end; None if the input ends before."""
    try:
        while True:
            select.select([reading], [], [])
            numbers = os.read(reading, 64)
            if found := [n for n in numbers if n in _SIGNALS]:
                return found[0]
            if not numbers:
                return None
    finally:
        os.close(reading)


def _children() -> list[int]:
    """Processes that this one started. Workers end their own when their parent is gone."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError, IndexError):
            # Its name, in brackets, may contain spaces. State and parent follow.
            words = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(words[1]) == os.getpid():
                found.append(int(folder.name))
    return found
