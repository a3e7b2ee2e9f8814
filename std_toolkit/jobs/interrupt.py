"""SIGINT and SIGTERM end a program within seconds, whatever it computes.

Python runs a handler when the interpreter has control again. A mapper or a training step may keep
it for minutes. A process beside the program therefore ends it if it still runs some seconds after
the signal, also while it starts (imports) or leaves (waits for threads). Every file is written
atomically, so that this loses only the item in work.
"""

import atexit
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from std_toolkit.jobs import guard

GRACE_S = 2.5
"""Seconds from a signal until the program is ended from outside the computation.

The guard takes up to 1 s more, and the system up to another second where many programs compete.
"""

INTERRUPTED = 130

# Of the outermost block, while there is one.
_signals: list[int] | None = None
# Of a program that signals ended.
_status: int | None = None


@contextmanager
def ended_by_signals(message: str, *, grace_s: float | None = None) -> Iterator[list[int]]:
    """SIGTERM interrupts the block as SIGINT does, and both are recorded.

    Outside the main thread, where signals cannot be handled, and within another such block, it
    changes nothing.

    Args:
        message: line on stderr if the process is ended from outside the computation.
        grace_s: seconds from a signal until the process ends in any case, for a block that is
            the whole program; a signal behind it ends the process at once. None for a block
            within another program, and for one that finishes what it has begun.

    Yields:
        A list that each signal adds its number to, for a block that ends by other means than a
        KeyboardInterrupt after one.
    """
    global _signals
    if _signals is not None:
        yield _signals
        return
    if threading.current_thread() is not threading.main_thread():
        yield []
        return
    # The guard starts first: before the handlers are there, SIGTERM ends the process.
    guarding = None if grace_s is None else _guard(message, grace_s)
    signals = _signals = []

    def terminate(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        _interrupt(number, frame)

    def interrupt(number: int, _frame: FrameType | None) -> None:
        signals.append(number)
        raise KeyboardInterrupt

    before = {signal.SIGTERM: signal.signal(signal.SIGTERM, terminate)}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        before[signal.SIGINT] = signal.signal(signal.SIGINT, interrupt)
    try:
        yield signals
    finally:
        _signals = None
        if guarding is None:
            for number, handler in before.items():
                signal.signal(number, handler)
        else:
            # All that is left is to unload modules, which may take seconds, and to wait for
            # threads. The guard ends the latter.
            _leave(guarding)


@contextmanager
def whole_imports() -> Iterator[None]:
    """A signal within the block is handled behind it.

    Compiled modules that are interrupted while they make their types (Mitsuba, PySide) end the
    process by themselves, with a status and lines of their own. The guard ends a block that takes
    too long.
    """
    held: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        for number in guard.SIGNALS:
            handler = signal.getsignal(number)
            if callable(handler):
                handlers[number] = handler
                signal.signal(number, lambda number, _frame: held.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if held:
            handlers[signal.Signals(held[0])](held[0], None)


def status_after(signals: list[int]) -> int:
    """Exit status of a program that these signals ended; the process leaves with it in any case.

    Libraries that were interrupted may crash while Python unloads them.
    """
    global _status
    _status = 128 + signals[0] if signals else INTERRUPTED
    return _status


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Do what SIGINT does here: a window closes, a server stops, a computation is interrupted."""
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(number, frame)
    else:  # SIGINT is ignored, as in the background of a script
        raise KeyboardInterrupt


def _guard(message: str, grace_s: float) -> int | None:
    """Start the guard; returns the pipe that signals are written to. None without a guard."""
    from_signals, to_guard = os.pipe()
    from_guard, to_thread = os.pipe()
    for end in (from_signals, to_guard):
        os.set_blocking(end, False)
    words = [str(os.getpid()), str(grace_s), message]
    try:
        process = subprocess.Popen(
            [sys.executable, "-I", "-S", guard.__file__, *words],
            stdin=from_signals,
            stdout=to_thread,
            # Out of reach of Ctrl-C, which goes to all processes of a terminal.
            start_new_session=True,
        )
    except OSError:  # no memory or no processes left: no reason not to do the work
        os.close(to_guard)
        os.close(from_guard)
        return None
    finally:
        os.close(from_signals)
        os.close(to_thread)
    signal.set_wakeup_fd(to_guard, warn_on_full_buffer=False)
    # Registered early, and so called after what libraries leave to the end.
    atexit.register(_end_with_status)
    # The signals of a forked worker are none of this program.
    os.register_at_fork(after_in_child=_forget)
    threading.Thread(
        target=_end, args=(from_guard, message, process), name="signals", daemon=True
    ).start()
    return to_guard


def _forget() -> None:
    """In a forked process: no guard, and SIGTERM ends it."""
    global _signals
    _signals = None
    signal.set_wakeup_fd(-1)
    if callable(signal.getsignal(signal.SIGTERM)):
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _end_with_status() -> None:
    """Leave without unloading modules if signals ended the program."""
    if _status is None:
        return
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(_status)


def _end(from_guard: int, message: str, process: subprocess.Popen[bytes]) -> None:
    """End this process when the guard says so, with the status of a signal."""
    # Signals are for the main thread: while it lets them wait, they wait.
    signal.pthread_sigmask(signal.SIG_BLOCK, guard.SIGNALS)
    number = os.read(from_guard, 1)
    if number:
        if _signals is not None:  # within the block, which tells by itself if it can
            os.write(2, f"{message}\n".encode())
        os._exit(128 + number[0])
    process.wait()  # it was killed


def _leave(guarding: int) -> None:
    with suppress(OSError):
        os.write(guarding, bytes([guard.TOLD]))
    for number in guard.SIGNALS:
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
