"""A controller with its threads and an event loop, and no window."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from pathlib import Path

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.image_cache import ImageCache
from annotator.app.tasks import ThreadRunner
from annotator.session import Session


class Desk:
    """A scene being annotated; results of threads come in while `wait` waits."""

    def __init__(self, root: Path, *, annotator: str = "mk") -> None:
        self._calls: queue.Queue[Callable[[], None]] = queue.Queue()
        self._runner = ThreadRunner(self._calls.put)
        self.session = Session.open(root, annotator=annotator)
        self.images = ImageCache(self.session.scene)
        frames = [f.id for f in self.session.scene.frames]
        self.controller = Controller(
            self.session, self.images, runner=self._runner, view_frames=frames
        )
        self.events: list[Event] = []
        self.controller.subscribe(self.events.append)

    def wait(self, until: Callable[[], bool], *, at_most_s: float = 60.0) -> None:
        """Do what the threads hand in until something holds."""
        end = time.monotonic() + at_most_s
        while not until():
            assert time.monotonic() < end, "it did not come about"
            try:
                self._calls.get(timeout=0.05)()
            except queue.Empty:
                continue

    def rest(self, seconds: float) -> None:
        """Do what the threads hand in for some time."""
        end = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() >= end)

    def wait_until_idle(self) -> None:
        self.wait(lambda: self.controller.task is None)

    def told(self, kind: str) -> list[Event]:
        return [e for e in self.events if e.kind == kind]

    @property
    def messages(self) -> list[str]:
        return [e.text for e in self.told("message")]

    def close(self) -> None:
        assert self._runner.close()
        self.images.close()
        self.session.close()
