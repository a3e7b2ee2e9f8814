"""A small process beside a program that ends it some seconds after a signal.

It is run by its path, without site packages: `guard.py PID SECONDS MESSAGE`. Its input is the pipe
that Python writes the numbers of signals to, in C, whatever holds the interpreter: compiled code
that keeps the interpreter's lock for minutes (a surface reconstruction, the loading of a library
of a gigabyte) lets no handler and no thread of the program run.
"""

import os
import select
import signal
import sys
import time
from contextlib import suppress

SIGNALS = (signal.SIGINT, signal.SIGTERM)
TOLD = 0
"""Byte of a program that has printed by itself how to resume."""

_LAST_S = 1.0


def main(program: int, grace_s: float, message: str) -> None:
    """Wait for a signal; let the program end itself, then end it. Tell how to resume if it did not.

    At the end of the time, the number of the signal goes to the output, where a thread of the
    program waits for it to leave with the right status. A program that does not is killed.
    """
    for number in (*SIGNALS, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    try:
        ended = os.pidfd_open(program)
    except (OSError, AttributeError):  # it has ended already; not Linux, or older than 5.3
        return
    told, deadline, first = False, None, 0
    inputs = [0, ended]
    while deadline is None or time.monotonic() < deadline:
        wait_s = None if deadline is None else max(deadline - time.monotonic(), 0.0)
        ready = select.select(inputs, [], [], wait_s)[0]
        if 0 in ready:
            numbers = os.read(0, 64)
            if not numbers:
                inputs.remove(0)
            told = told or TOLD in numbers
            signals = [n for n in numbers if n in SIGNALS]
            if deadline is None and signals:
                first, deadline = signals[0], time.monotonic() + grace_s
        if ended in ready:
            # Killed, or crashed as compiled code may when a callback is interrupted, or by the
            # handler of pycolmap's log library, which stands while pycolmap loads.
            if not told:
                _tell(message)
            return
    children = [child for child in children_of(program) if child != os.getpid()]
    with suppress(OSError):
        os.write(1, bytes([first]))
    left = bool(select.select([ended], [], [], _LAST_S / 3)[0])
    # Workers of `multiprocessing` end with their parent; others would stay. The program may be
    # waiting for one of them, with the lock.
    for child in children:
        _kill(child)
    left = left or bool(select.select([ended], [], [], 2 * _LAST_S / 3)[0])
    if not left:
        if not told:
            _tell(message)
        _kill(program)


def _tell(message: str) -> None:
    with suppress(OSError):
        os.write(2, f"{message}\n".encode())


def _kill(process: int) -> None:
    with suppress(OSError):
        # A program of others has a group of its own.
        if os.getpgid(process) == process:
            os.killpg(process, signal.SIGKILL)
        else:
            os.kill(process, signal.SIGKILL)


def children_of(program: int) -> list[int]:
    """Processes that a process started."""
    found = []
    for name in os.listdir("/proc"):  # noqa: PTH208 - pathlib takes as long to load as Python
        if name.isdecimal():
            with suppress(OSError, ValueError, IndexError), open(f"/proc/{name}/stat") as file:  # noqa: PTH123
                # Its name, in brackets, may contain spaces. State and parent follow.
                if int(file.read().rpartition(")")[2].split()[1]) == program:
                    found.append(int(name))
    return found


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3])
