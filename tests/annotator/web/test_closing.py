"""The server ends: what writes to the scene ends first."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from scene_on_disk import write_scene

pytest.importorskip("trame")

from trame.app import get_server

from annotator.app import operations
from annotator.app.tasks import ThreadRunner
from annotator.session import Session
from annotator.web.front_end import FrontEnd
from std_toolkit.errors import ToolkitError
from std_toolkit.labels import propagate
from std_toolkit.scene import Scene


@pytest.mark.slow
def test_the_scene_is_nobody_else_s_before_its_labels_are_propagated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write_scene(tmp_path / "scene").root
    began, closing = threading.Event(), threading.Event()
    seen: list[str] = []
    real = propagate.propagate_labels

    def held(scene: Scene, *args: object) -> object:
        began.set()
        assert closing.wait(30)
        # Longer than what can be cancelled is waited for.
        threading.Event().wait(1.0)
        try:
            Session.open(root, annotator="other").close()
        except ToolkitError as error:
            seen.append(error.problem.split(":")[0])
        labels = real(scene, *args)  # type: ignore[arg-type]
        seen.append("propagated")
        return labels

    async def work(session: Session) -> None:
        front_end = FrontEnd(get_server("closing", client_type="vue3"), session)
        operations.propagate(front_end.controller)
        while not began.is_set():
            await asyncio.sleep(0.01)
        closing.set()
        front_end.close()

    monkeypatch.setattr(propagate, "propagate_labels", held)
    monkeypatch.setattr(ThreadRunner.close, "__defaults__", (0.2,))
    with Session.open(root, annotator="mk") as session:
        asyncio.run(work(session))
    assert seen == ["another process is annotating this scene", "propagated"]
    with Session.open(root, annotator="other") as session:
        assert session.recovery is None


# VTK ends the process with status 1 if a callback raises KeyboardInterrupt.
IN_A_CALLBACK = """
import asyncio, os, signal, sys, time
from vtkmodules.vtkCommonCore import vtkObject
from annotator.web.web_app import until_signal
from std_toolkit.cli.command import exit_status

def callback(caller, event):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.05)  # a handler runs here

async def serving():
    caller = vtkObject()
    caller.AddObserver("ModifiedEvent", callback)
    caller.Modified()
    try:
        await asyncio.sleep(60)
    finally:
        print("closed", flush=True)

sys.exit(exit_status(lambda: asyncio.run(until_signal(serving())), program="p"))
"""


def test_a_signal_within_a_callback_of_the_views_closes_the_scene() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IN_A_CALLBACK], capture_output=True, text=True, timeout=60,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (130, "closed\n"), done.stderr
