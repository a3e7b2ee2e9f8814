"""Functions that the job tests run in other processes, where only importable ones arrive."""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic


def square(x: int) -> int:
    return x * x


def slow_first(x: int) -> int:
    time.sleep(0.3 if x == 0 else 0)
    return x


def odd_raises(x: int) -> int:
    if x % 2:
        raise ToolkitError("odd", path="numbers", value=x)
    return x


def raise_foreign(x: int) -> int:
    raise RuntimeError("two\nlines of it")


def call_exit(x: int) -> int:
    if x == 1:
        sys.exit(0)
    return x


def return_unpicklable(x: int) -> object:
    return (lambda: x) if x == 1 else x


def process_id(x: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def killed_once(job: tuple[int, Path]) -> int:
    """Item 3 kills its worker the first time."""
    x, folder = job
    mark = folder / "was_killed"
    if x == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def three_aborts(x: int) -> int:
    if x == 3:
        os.abort()
    time.sleep(0.02)
    return x


def end_quietly(x: int) -> int:
    if x == 1:
        os._exit(0)
    return x


class KillsWhileSent:
    """The process that sends it dies with the first half of it in the pipe."""

    def __reduce__(self) -> tuple[type, tuple[bytes]]:
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGKILL)).start()
        return bytes, (b"x" * 200_000_000,)


def killed_while_sending(x: int) -> object:
    return KillsWhileSent() if x == 1 else x


def sleep_long(job: tuple[int, Path]) -> int:
    x, folder = job
    (folder / f"started_{x}_{os.getpid()}").touch()
    time.sleep(120)
    return x


def write_square(job: tuple[int, Path]) -> str:
    x, folder = job
    name = f"{x:03d}.txt"
    write_bytes_atomic(folder / name, f"{x * x}\n".encode() * 1000)
    return name


def faults_of_images(_: int) -> int:
    """Pages that the system cleared for images whose like were dropped before."""

    def images() -> None:
        _ = [np.ones(1 << 20) for _ in range(6)]

    images()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(5):
        images()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
