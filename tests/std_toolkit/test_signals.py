"""SIGINT and SIGTERM end a program within 5 s, with a line that says how to resume."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from std_toolkit.jobs.interrupt import ended_by_signals

pytestmark = pytest.mark.slow

SCRIPT = """
import hashlib, os, sys, threading, time
from std_toolkit.cli.command import exit_status

def loop():
    while True:
        sum(range(100))

def within_a_library():  # Python handles no signal before it returns
    hashlib.pbkdf2_hmac("sha512", b"a", b"b", 10**9)

def after_pycolmap():  # its log library handles SIGTERM by itself
    import pycolmap
    print("imported", flush=True)
    loop()

def with_the_lock():  # compiled code that no thread of Python runs beside
    sum(range(10**12))

def a_forked_worker_is_terminated():  # as multiprocessing does, which concerns the worker only
    import os, signal
    for _ in range(2):
        child = os.fork()
        if child == 0:
            try:
                time.sleep(60)
            finally:
                os._exit(1)
        time.sleep(0.2)
        os.kill(child, signal.SIGTERM)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -15
    time.sleep(4)
    print("still here", flush=True)

def leaves_slowly():  # what it computed is released behind the block
    class Slow:
        def __del__(self):
            for _ in range(600):
                time.sleep(0.1)
    import atexit
    atexit.register(Slow().__del__)
    time.sleep(60)

def a_library_reports_an_error():  # as drjit does of a loop that it traces
    try:
        time.sleep(60)
    except KeyboardInterrupt as interrupt:
        raise RuntimeError("a callback failed") from interrupt

def a_library_exits():  # as Lightning does after SIGTERM
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        pass
    sys.exit(3)

def a_library_crashes():
    import os, signal
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        signal.signal(signal.SIGSEGV, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGSEGV)

class CrashesAtTheEnd:  # as Mitsuba does if its import was interrupted
    def __del__(self):
        os._exit(1)

def unloading_crashes():
    global library
    library = CrashesAtTheEnd()
    time.sleep(60)

def a_module_loads():  # which may neither be interrupted nor go on for long
    from std_toolkit.jobs.interrupt import whole_imports
    with whole_imports():
        try:
            print("imports started", flush=True)
            time.sleep(1 if "short" in sys.argv else 60)
        except KeyboardInterrupt:
            os._exit(1)
    time.sleep(60)

def an_item_fails():  # and the command goes on to its end
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        return 1

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
    return globals()[sys.argv[1]]() or 0

sys.exit(exit_status(run, program="p", on_interrupt="`p` resumes", grace_s=3))
"""


def started(tmp_path: Path, work: str, *, ignored: bool = False) -> subprocess.Popen[str]:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    handling = signal.SIG_IGN if ignored else signal.SIG_DFL
    process = subprocess.Popen(
        [sys.executable, str(script), *work.split()],
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
        ("a_library_reports_an_error", signal.SIGINT),
        ("a_library_reports_an_error", signal.SIGTERM),
        ("a_library_exits", signal.SIGTERM),
        ("a_library_exits", signal.SIGINT),
        ("an_item_fails", signal.SIGTERM),
        ("an_item_fails", signal.SIGINT),
        ("a_thread_goes_on", signal.SIGTERM),
        ("after_pycolmap", signal.SIGTERM),
        ("leaves_slowly", signal.SIGINT),
        ("unloading_crashes", signal.SIGINT),
        ("unloading_crashes", signal.SIGTERM),
        ("a_module_loads short", signal.SIGINT),
        ("a_module_loads short", signal.SIGTERM),
        ("a_module_loads long", signal.SIGTERM),
        pytest.param("swallowed", signal.SIGTERM, marks=pytest.mark.long),
    ],
)
def test_the_program_ends_in_time(work: str, number: signal.Signals, tmp_path: Path) -> None:
    process = started(tmp_path, work)
    if work.startswith(("after_pycolmap", "a_module_loads")):
        assert process.stdout is not None and process.stdout.readline().endswith("ed\n")
    time.sleep(0.1)
    began = time.monotonic()
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - began < 5
    assert errors == "interrupted; `p` resumes\n"
    assert process.returncode == 128 + number


def test_compiled_code_with_the_interpreters_lock_is_ended(tmp_path: Path) -> None:
    process = started(tmp_path, "with_the_lock")
    time.sleep(0.1)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=70)
    assert time.monotonic() - began < 5
    assert errors == "interrupted; `p` resumes\n"
    assert process.returncode == -signal.SIGKILL


def test_a_program_that_crashes_after_a_signal_is_told(tmp_path: Path) -> None:
    """As PySide does when its import is interrupted."""
    process = started(tmp_path, "a_library_crashes")
    time.sleep(0.5)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=20)
    assert errors == "interrupted; `p` resumes\n"
    assert process.returncode == -signal.SIGSEGV


def test_a_program_that_was_killed_is_told(tmp_path: Path) -> None:
    process = started(tmp_path, "loop")
    process.kill()
    _, errors = process.communicate(timeout=20)
    assert errors == "interrupted; `p` resumes\n"


def test_a_signal_of_a_forked_worker_is_its_own(tmp_path: Path) -> None:
    process = started(tmp_path, "a_forked_worker_is_terminated")
    output, errors = process.communicate(timeout=20)
    assert (output, errors, process.returncode) == ("still here\n", "", 0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("program", ["std-bench", "std-curate"])
def test_a_signal_while_a_program_starts_is_told(program: str, number: signal.Signals) -> None:
    """Options are imported before the command begins: here, a library that takes a minute.

    A library may report an import that was interrupted as an error of its own.
    """
    code = (
        "import sys, time\n"
        "import std_toolkit.cli.command as command\n"
        "def slowly(reference):\n    print('begun', flush=True)\n"
        "    try:\n        time.sleep(60)\n    except KeyboardInterrupt:\n        pass\n"
        "    raise ImportError('a part of it is missing')\n"
        "command._load = slowly\n"
        "from std_toolkit.cli.programs import run\n"
        f"sys.argv = ['{program}', {'depth' if program == 'std-bench' else 'check'!r}]\n"
        f"sys.exit(run('{program}'))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Jobs in the background of a shell ignore SIGINT, and so do their children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert errors == "interrupted; nothing was begun\n"
    assert process.returncode == 128 + number


def test_an_interrupt_while_a_program_loads_is_told(tmp_path: Path) -> None:
    """A signal is handled once the modules of the command line have loaded."""
    (tmp_path / "slow_program.py").write_text(
        "print('begun', flush=True)\nimport time; time.sleep(60)"
    )
    code = (
        "import sys\n"
        "from std_toolkit.cli import programs\n"
        "programs.PROGRAMS['std-bench'] = 'slow_program'\n"
        "sys.exit(programs.bench())\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert errors == "interrupted; nothing was begun\n"
    assert process.returncode == 130


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
