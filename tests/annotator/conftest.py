"""A virtual display and Qt on it, for the tests that ask for them.

Headless tests of the annotator run without any of it, and nothing here reaches other packages.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING

import pytest

from tests.skips import program_missing

if TYPE_CHECKING:
    from PySide6.QtWidgets import QApplication
    from pytestqt.qtbot import QtBot

SCREEN = "1600x1200x24"
# The same pictures on every machine, whatever GPU and desktop it has.
ENVIRONMENT = {
    "QT_API": "pyside6",
    "QT_QPA_PLATFORM": "xcb",
    "QT_SCALE_FACTOR": "1",
    "LIBGL_ALWAYS_SOFTWARE": "1",
}
_servers: list[subprocess.Popen[bytes]] = []


@atexit.register
def _stop_servers() -> None:
    # Exit handlers run in reverse order, so Qt, imported later, has left its display by now; it
    # would end the process if the display went first.
    for server in _servers:
        server.terminate()
        server.wait(timeout=10)


def pytest_configure(config: pytest.Config) -> None:
    """Load pytest-qt for these tests alone: it imports Qt, and fails where there is none."""
    if find_spec("PySide6") is None:
        return
    for name, value in {"qt_log": True, "qt_log_format": None}.items():
        if not hasattr(config.option, name):  # the command line was parsed without the plug-in
            setattr(config.option, name, value)
    config.pluginmanager.import_plugin("pytestqt.plugin")


@pytest.fixture(scope="session")
def display_server() -> str:
    """Name of a virtual X display of 1600x1200 pixels that lives as long as this process."""
    program = shutil.which("Xvfb")
    if program is None:
        program_missing("Xvfb", "xvfb")
    # Where it can be had: the server must not outlive a run that is killed.
    tied = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
    number, tell_number = os.pipe()
    # With -displayfd it takes a free display and tells its number once it can be used.
    command = [*tied, program, "-displayfd", str(tell_number), "-screen", "0", SCREEN]
    with tempfile.TemporaryFile() as log, os.fdopen(number, "rb") as told:
        server = subprocess.Popen(
            [*command, "-nolisten", "tcp", "-noreset"],
            pass_fds=[tell_number],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )
        _servers.append(server)
        os.close(tell_number)
        display = told.readline().strip().decode()
        log.seek(0)
        assert display, f"Xvfb does not start: {log.read().decode(errors='replace')}"
    return f":{display}"


@pytest.fixture
def display(display_server: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """The environment of a desktop drawn in software, for this test and what it starts."""
    for name, value in {**ENVIRONMENT, "DISPLAY": display_server}.items():
        monkeypatch.setenv(name, value)
    return display_server


@pytest.fixture(autouse=True)
def _off_screen_by_egl(monkeypatch: pytest.MonkeyPatch) -> None:
    """VTK chooses GLX or EGL once, by the display that the first test happens to have."""
    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    monkeypatch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")


@pytest.fixture(autouse=True)
def _no_window_is_left() -> Iterator[None]:
    """Delete closed windows, and let go of the GL context that Qt or VTK made current.

    While a thread has a context of GLX, EGL refuses it any: the tests of the renderers would fail.
    """
    yield
    if "PySide6.QtWidgets" in sys.modules:
        from PySide6.QtCore import QCoreApplication, QEvent
        from PySide6.QtGui import QOpenGLContext

        # Outside an event loop Qt deletes what was closed only when told to.
        QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)
        context = QOpenGLContext.currentContext()
        if context is not None:
            context.doneCurrent()
    if "vtkmodules.vtkRenderingOpenGL2" in sys.modules:
        gl = ctypes.CDLL("libGL.so.1")
        gl.glXGetCurrentDisplay.restype = ctypes.c_void_p
        gl.glXMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_ulong, ctypes.c_void_p]
        if current := gl.glXGetCurrentDisplay():
            gl.glXMakeCurrent(current, 0, None)


@pytest.fixture(scope="session")
def qapp(display_server: str) -> Iterator[QApplication]:
    """The application on the virtual display, instead of pytest-qt's on whatever there is."""
    from PySide6.QtWidgets import QApplication

    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**ENVIRONMENT, "DISPLAY": display_server}.items():
            patch.setenv(name, value)
        app = QApplication.instance() or QApplication(["std-annotate"])
    assert isinstance(app, QApplication)
    assert app.platformName() == "xcb"
    yield app


@pytest.fixture
def qtbot(display: str, qtbot: QtBot) -> QtBot:
    """pytest-qt's, with the environment of the display."""
    return qtbot
