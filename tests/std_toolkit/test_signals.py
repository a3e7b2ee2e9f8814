"""SIGINT and SIGTERM end a program within 5 s, with a line that says how to resume."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from std_toolkit.cli.interrupt import ended_by_signals

pytestmark = pytest.mark.slow

SCRIPT = """
import hashlib, sys, threading, time
from std_toolkit.cli.command import exit_status

def loop():
    while True:
        sum(range(100))

def within_a_library():  # Python handles no signal before it returns
    hashlib.pbkdf2_hmac("sha512", b"a", b"b", 10**9)

def after_pycolmap():  # its log library handles SIGTERM by itself
    import pycolmap
    from std_toolkit.cli.interrupt import keep_handlers
    keep_handlers()
    print("imported", flush=True)
    loop()

def a_thread_goes_on():
    threading.Thread(target=within_a_library).start()
    time.sleep(60)

def swallowed(say=""):
    while True:
        try:
            print(say, flush=True)
            time.sleep(60)
        except KeyboardInterrupt:
            pass

def with_a_child():
    import subprocess
    child = subprocess.Popen(["sleep", "61"])
    swallowed(child.pid)  # within its block, no signal ends this process by itself

def run():
    print("begun", flush=True)
    globals()[sys.argv[1]]()
    return 0

sys.exit(exit_status(run, program="p", on_interrupt="`p` resumes"))
"""


def started(tmp_path: Path, work: str, *, ignored: bool = False) -> subprocess.Popen[str]:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    handling = signal.SIG_IGN if ignored else signal.SIG_DFL
    process = subprocess.Popen(
        [sys.executable, str(script), work],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, handling),
    )
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    return process


@pytest.mark.parametrize(
    ("work", "number"),
    [
        ("loop", signal.SIGINT),
        ("loop", signal.SIGTERM),
        ("within_a_library", signal.SIGTERM),
        pytest.param("within_a_library", signal.SIGINT, marks=pytest.mark.long),
        ("a_thread_goes_on", signal.SIGTERM),
        ("after_pycolmap", signal.SIGTERM),
        pytest.param("swallowed", signal.SIGTERM, marks=pytest.mark.long),
    ],
)
def test_the_program_ends_in_time(work: str, number: signal.Signals, tmp_path: Path) -> None:
    process = started(tmp_path, work)
    if work == "after_pycolmap":
        assert process.stdout is not None and process.stdout.readline() == "imported\n"
    time.sleep(0.1)
    began = time.monotonic()
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - began < 5
    assert errors == "interrupted; `p` resumes\n"
    assert process.returncode == 128 + number


def test_a_program_in_the_background_is_terminated(tmp_path: Path) -> None:
    process = started(tmp_path, "loop", ignored=True)
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=20)
    assert errors == "interrupted; `p` resumes\n" and process.returncode == 143


def test_children_end_with_the_program(tmp_path: Path) -> None:
    process = started(tmp_path, "with_a_child")
    assert process.stdout is not None
    child = int(process.stdout.readline())
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=20)
    command = Path(f"/proc/{child}/cmdline")  # empty once it has ended
    assert not command.exists() or command.read_bytes() == b""


def test_handlers_are_as_before() -> None:
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with ended_by_signals("message"):
        assert signal.getsignal(signal.SIGTERM) != before[0]
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before
    assert signal.set_wakeup_fd(-1) == -1
