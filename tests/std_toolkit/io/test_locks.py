"""Locks on a drive that several computers share: heartbeats, and holders that are gone."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io import locks
from std_toolkit.io.locks import DEAD_S, hold_lock, lock_holder, person_of

NAME = "annotate.lock"
# A process that says that it runs on another computer, holds the lock, and tells what it is asked.
HOLDER = """
import socket, sys
from pathlib import Path
socket.gethostname = lambda: "lab2"
from std_toolkit.errors import ToolkitError
from std_toolkit.io.locks import hold_lock
with hold_lock(Path(sys.argv[1]), "annotate.lock", doing="annotating", note="annotator Ann",
               beats=True) as held:
    print("held", flush=True)
    for _ in sys.stdin:
        try:
            held.check()
            print("mine", flush=True)
        except ToolkitError as error:
            print(error, flush=True)
"""


@pytest.fixture
def far(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Holds the lock of `tmp_path` on "lab2"."""
    words = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(words, stdin=-1, stdout=-1, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def ask(process: subprocess.Popen[str]) -> str:
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write("?\n")
    process.stdin.flush()
    return process.stdout.readline().strip()


def refused(root: Path, *, take_over: bool = False) -> ToolkitError:
    with (
        pytest.raises(ToolkitError) as found,
        hold_lock(root, NAME, doing="annotating", beats=True, take_over=take_over),
    ):
        pass
    return found.value


def test_a_holder_with_a_heartbeat_keeps_the_lock(
    far: subprocess.Popen[str], tmp_path: Path
) -> None:
    assert person_of(lock_holder(tmp_path, NAME)) == "Ann (lab2)"
    for take_over in (False, True):
        error = refused(tmp_path, take_over=take_over)
        assert "annotator Ann" in error.problem and "take" not in (error.hint or "")
    assert ask(far) == "mine"


def test_a_silent_holder_is_taken_over_on_request_and_notices(
    far: subprocess.Popen[str], tmp_path: Path
) -> None:
    old = time.time() - DEAD_S - 600
    os.utime(tmp_path / ".std" / NAME, (old, old))
    error = refused(tmp_path)
    assert "annotator Ann" in error.problem
    assert "not heard of for 13 minutes" in (error.hint or "") and locks.TAKE_OVER in error.hint
    note = "annotator Ben"
    with hold_lock(tmp_path, NAME, doing="annotating", note=note, beats=True, take_over=True) as h:
        h.check()
        assert person_of(lock_holder(tmp_path, NAME)) == f"Ben ({socket.gethostname()})"
        assert "Ben" in ask(far)
        refused(tmp_path, take_over=True)  # a holder of this computer is never gone
    assert lock_holder(tmp_path, NAME) == ""


def test_a_drive_without_shared_locks_is_told_by_the_heartbeat(tmp_path: Path) -> None:
    (tmp_path / ".std").mkdir()
    path = tmp_path / ".std" / NAME
    path.write_text("kim@lab2 pid 12, annotator Ann\n")
    assert person_of(lock_holder(tmp_path, NAME)) == "Ann (lab2)"
    assert "annotator Ann" in refused(tmp_path).problem
    old = time.time() - DEAD_S - 1
    os.utime(path, (old, old))
    assert lock_holder(tmp_path, NAME) == ""
    with hold_lock(tmp_path, NAME, doing="annotating", beats=True):
        pass


def test_the_heart_beats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "BEAT_S", 0.01)
    with hold_lock(tmp_path, NAME, doing="annotating", beats=True):
        path = tmp_path / ".std" / NAME
        os.utime(path, (1, 1))
        for _ in range(500):
            if path.stat().st_mtime > 1:
                break
            time.sleep(0.01)
        assert path.stat().st_mtime > 1
