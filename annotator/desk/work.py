"""The computations of a controller: what a person started, and what runs beside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from annotator.desk.events import Event
from annotator.desk.runner import Runner, Task
from std_toolkit.errors import ToolkitError


class Work:
    """Starts computations and tells how they end.

    Attributes:
        task: what a person started and is under way, or None.
    """

    def __init__(self, runner: Runner, emit: Callable[[Event], None]) -> None:
        self.task: Task | None = None
        self._runner = runner
        self._emit = emit
        self._told: dict[str, str] = {}
        self._aside: dict[str, Task] = {}

    def start(
        self,
        title: str,
        work: Callable[[Task], Any],
        finish: Callable[[Any], None],
        *,
        alone: bool = False,
    ) -> Task | None:
        """Run `work(task)` aside, then `finish(result)` here; one computation at a time.

        Args:
            alone: nothing may be edited meanwhile; see `Task`.
        """
        if self.task is not None:
            self._tell(f"{self.task.title} is still running.", "warning")
            return None
        task = self.task = Task(title, alone=alone)
        self._emit(Event("busy", text=title))

        def done(result: Any, error: Exception | None) -> None:
            self.task = None
            self._emit(Event("busy"))
            if task.cancelled:
                self._tell(f"{title}: cancelled, nothing was changed.")
            elif isinstance(error, ToolkitError):
                self._tell(str(error), "error")
            elif error is not None:
                self._tell(f"{title} failed: {type(error).__name__}: {error}", "error")
            else:
                self._finish(finish, result)

        self._runner.submit(task, lambda: work(task), done)
        return task

    def start_aside(
        self,
        key: str,
        work: Callable[[Task], Any],
        finish: Callable[[Any], None],
        *,
        delay: float = 0.0,
    ) -> None:
        """Run `work(task)` beside everything else, then `finish(result)` here.

        Newer work of the same key replaces older, so panels may ask for it after every edit.

        Args:
            key: what it is, for people.
            delay: seconds to wait first: a burst of edits is worked off once.
        """
        task = self._aside[key] = Task(key)

        def done(result: Any, error: Exception | None) -> None:
            if self._aside.get(key) is task:
                del self._aside[key]
            if task.cancelled:
                return
            if error is not None:
                text = str(error) if isinstance(error, ToolkitError) else repr(error)
                # Once: the same trouble comes after every edit.
                if self._told.get(key) != text:
                    self._told[key] = text
                    self._tell(f"{key}: {text}", "warning")
            else:
                self._told.pop(key, None)
                self._finish(finish, result)

        self._runner.submit_aside(key, task, lambda: work(task), done, delay=delay)

    def cancel_aside(self, *keys: str) -> None:
        """What runs beside under these keys is not wanted any more."""
        for key in keys:
            if key in self._aside:
                self._aside[key].cancel()

    def _finish(self, finish: Callable[[Any], None], result: Any) -> None:
        try:
            finish(result)
        except ToolkitError as error:
            self._tell(str(error), "error")

    def _tell(self, text: str, level: Any = "info") -> None:
        self._emit(Event("message", text=text, level=level))
