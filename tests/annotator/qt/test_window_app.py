"""The program as a whole: started by its command, and when something unforeseen happens."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from bench import Bench

from annotator.qt.qt_app import tell_troubles
from annotator.session import Session

# What a person does: look at the window for a while, move the object, close the window.
PERSON = """
import os, signal, sys
from PySide6.QtCore import QTimer, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from annotator.qt.qt_app import make_application
from annotator import cli

def person():
    shell = next(w for w in QApplication.topLevelWidgets() if type(w).__name__ == "Shell")
    if shell.workspace is None:
        QTimer.singleShot(100, person)
        return
    QTest.keyClick(shell.workspace.views.tiles[0].view, Qt.Key.Key_Right)
    if "SIGTERM" in os.environ:
        os.kill(os.getpid(), signal.SIGTERM)
        return
    QTimer.singleShot(0, answer)
    print(shell.windowTitle(), shell.close())

def answer():
    dialog = QApplication.activeModalWidget()
    if dialog is None:
        QTimer.singleShot(20, answer)
    else:
        QTest.mouseClick(dialog.buttons["keep"], Qt.MouseButton.LeftButton)

make_application()
QTimer.singleShot(200, person)
sys.exit(cli.main())
"""


def test_the_command_opens_a_window_and_ends_when_it_is_closed(
    display: str, root: Path, tmp_path: Path
) -> None:
    del display  # whose environment the program inherits
    run = subprocess.run(
        [sys.executable, "-c", PERSON, str(root), "--annotator", "eva", "--quiet"],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout == "bench · eva · std-annotate[*] True\n"
    assert run.stderr == ""
    with Session.open(root, annotator="mk") as session:
        assert session.recovery is not None
        assert (session.recovery.count, session.recovery.annotator) == (1, "eva")
        session.recover()


def test_a_signal_ends_the_program_without_a_question(
    display: str, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del display
    monkeypatch.setenv("SIGTERM", "1")
    run = subprocess.run(
        [sys.executable, "-c", PERSON, str(root), "--annotator", "eva", "--quiet"],
        capture_output=True,
        text=True,
        timeout=120,
    )
    told = "edits that were not saved are kept: open the scene again to recover them"
    assert (run.returncode, run.stderr) == (143, f"interrupted; {told}\n")
    with Session.open(root, annotator="mk") as session:
        assert session.recovery is not None and session.recovery.count == 1
        session.recover()


def test_unforeseen_errors_appear_in_the_window(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    tell_troubles(bench.shell)
    try:
        raise ZeroDivisionError("by design")
    except ZeroDivisionError as error:
        sys.excepthook(type(error), error, error.__traceback__)
    assert "ZeroDivisionError: by design" in bench.message()
    assert "Traceback" in capsys.readouterr().err
