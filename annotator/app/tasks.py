"""Background computations: runners, cancellation and progress."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from annotator.app.events import Event
from std_toolkit.errors import ToolkitError

WorkFunction = Callable[[], Any]

Done = Callable[[Any, Exception | None], None]


class Task:
    """Running computation; it polls `cancelled` and reports its progress.

    Attributes:
        title: displayed name.
        fraction: completed fraction, 0 to 1, or None if unknown.
        alone: whether edits are blocked meanwhile; such a task cannot be cancelled.
    """

    def __init__(self, title: str, *, alone: bool = False) -> None:
        self.title = title
        self.alone = alone
        self.fraction: float | None = None
        self._stop = threading.Event()

    def cancel(self) -> None:
        if not self.alone:
            self._stop.set()

    @property
    def cancelled(self) -> bool:
        return self._stop.is_set()

    def progress(self, fraction: float) -> None:
        self.fraction = fraction


class Runner(Protocol):
    """Runs work outside the front end's thread and calls `done` in that thread."""

    def submit(self, task: Task, work: WorkFunction, done: Done, *, beside: bool = False) -> None:
        """Run a computation that the user started.

        Args:
            beside: do not wait for one that runs.
        """

    def submit_aside(
        self, key: str, task: Task, work: WorkFunction, done: Done, *, delay: float = 0.0
    ) -> None:
        """Run an automatic update, which never delays computations that the user started.

        Newer work of the same key replaces older: waiting work is dropped; running work is
        cancelled and its result discarded.

        Args:
            delay: seconds to wait first, so that a burst of edits triggers one update.
        """


class InlineRunner:
    """Runs work immediately in the caller's thread, for scripts and tests."""

    def submit(
        self,
        task: Task,
        work: WorkFunction,
        done: Done,
        *,
        beside: bool = False,  # noqa: ARG002  nothing waits
    ) -> None:
        done(*_outcome(task, work))

    def submit_aside(  # nothing waits, so nothing is replaced
        self,
        key: str,  # noqa: ARG002
        task: Task,
        work: WorkFunction,
        done: Done,
        *,
        delay: float = 0.0,  # noqa: ARG002
    ) -> None:
        self.submit(task, work, done)


class ThreadRunner:
    """Three threads, one for each kind of work, started when first needed.

    Args:
        deliver: schedules a function in the front end's thread; callable from any thread, such
            as `loop.call_soon_threadsafe`.
    """

    def __init__(self, deliver: Callable[[Callable[[], None]], None]) -> None:
        self._deliver = deliver
        self._lanes = [_Lane(f"annotator-{kind}") for kind in ("work", "aside", "beside")]
        self._aside: dict[str, Task] = {}
        self._count = 0
        self._closed = False

    def submit(self, task: Task, work: WorkFunction, done: Done, *, beside: bool = False) -> None:
        self._count += 1
        lane = self._lanes[2 if beside else 0]
        lane.put(f"{self._count}", 0.0, lambda: self._run(task, work, done))

    def submit_aside(
        self, key: str, task: Task, work: WorkFunction, done: Done, *, delay: float = 0.0
    ) -> None:
        older = self._aside.get(key)
        if older is not None:
            older.cancel()
        self._aside[key] = task

        def finished(result: Any, error: Exception | None) -> None:
            if self._aside.get(key) is task:
                del self._aside[key]
                done(result, error)

        self._lanes[1].put(key, delay, lambda: self._run(task, work, finished))

    def close(self, timeout: float = 5.0) -> bool:
        """Stop delivering and wait for the threads; False if one does not end in time.

        The caller must cancel running tasks.
        """
        self._closed = True
        for task in self._aside.values():
            task.cancel()
        deadline = time.monotonic() + timeout
        closed = [lane.close(deadline - time.monotonic()) for lane in self._lanes]
        return all(closed)

    def _run(self, task: Task, work: WorkFunction, done: Done) -> None:
        result, error = _outcome(task, work)
        if not self._closed:
            self._deliver(lambda: None if self._closed else done(result, error))


def _outcome(task: Task, work: WorkFunction) -> tuple[Any, Exception | None]:
    try:
        return (None if task.cancelled else work()), None
    except Exception as error:  # passed to the front end's thread
        return None, error


class _Lane:
    """Worker thread with at most one waiting job per key."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: dict[str, tuple[float, Callable[[], None]]] = {}
        self._changed = threading.Condition()
        self._open = True
        self._thread: threading.Thread | None = None

    def put(self, key: str, delay: float, job: Callable[[], None]) -> None:
        with self._changed:
            if not self._open:
                return
            self._jobs[key] = (time.monotonic() + delay, job)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
                self._thread.start()
            self._changed.notify()

    def close(self, timeout: float) -> bool:
        with self._changed:
            self._open = False
            self._jobs.clear()
            self._changed.notify()
        if self._thread is None:
            return True
        self._thread.join(max(timeout, 0.0))
        return not self._thread.is_alive()

    def _work(self) -> None:
        while (job := self._next()) is not None:
            job()

    def _next(self) -> Callable[[], None] | None:
        with self._changed:
            while self._open:
                key = min(self._jobs, key=lambda k: self._jobs[k][0], default=None)
                wait = None if key is None else self._jobs[key][0] - time.monotonic()
                if key is not None and wait is not None and wait <= 0:
                    return self._jobs.pop(key)[1]
                self._changed.wait(wait)
        return None


class Work:
    """Starts computations and reports their results.

    Attributes:
        task: the running computation that the user started, or None.
    """

    def __init__(self, runner: Runner, emit: Callable[[Event], None]) -> None:
        self.task: Task | None = None
        self._runner = runner
        self._emit = emit
        self._reported: dict[str, str] = {}
        self._aside: dict[str, Task] = {}
        self._waiting: dict[str, Callable[[], object]] = {}

    def start_in_turn(self, title: str, begin: Callable[[], object]) -> None:
        """Call `begin`, which starts a computation, now or when those before it are done.

        Args:
            title: displayed name; one that waits already is not put in again.
        """
        if self.task is None:
            begin()
        elif title not in self._waiting and title != self.task.title:
            self._waiting[title] = begin
            self._tell(f"{title} starts after {self.task.title}.")

    def start(
        self,
        title: str,
        work: Callable[[Task], Any],
        finish: Callable[[Any], None],
        *,
        alone: bool = False,
        beside: bool = False,
    ) -> Task | None:
        """Run `work(task)` in the background, then `finish(result)` here; one at a time.

        Args:
            alone: block edits meanwhile; see `Task`.
            beside: run it beside one that runs already, unless that one blocks edits.
        """
        if self.task is not None and (self.task.alone or not beside):
            self._tell(f"{self.task.title} is still running.", "warning")
            return None
        task = Task(title, alone=alone)
        beside = self.task is not None
        if not beside:
            self.task = task
            self._emit(Event("busy", text=title))

        def done(result: Any, error: Exception | None) -> None:
            if not beside:
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
            self._go_on()

        options = {"beside": True} if beside else {}
        self._runner.submit(task, lambda: work(task), done, **options)
        return task

    def _go_on(self) -> None:
        """Start what waits, unless something else was started."""
        while self.task is None and self._waiting:
            self._waiting.pop(next(iter(self._waiting)))()

    def start_aside(
        self,
        key: str,
        work: Callable[[Task], Any],
        finish: Callable[[Any], None],
        *,
        delay: float = 0.0,
    ) -> None:
        """Run `work(task)` as an automatic update, then `finish(result)` here.

        Newer work of the same key replaces older, so panels can request it after every edit.

        Args:
            key: displayed name.
            delay: seconds to wait first, so that a burst of edits triggers one update.
        """
        task = self._aside[key] = Task(key)

        def done(result: Any, error: Exception | None) -> None:
            if self._aside.get(key) is task:
                del self._aside[key]
            if task.cancelled:
                return
            if error is not None:
                text = str(error) if isinstance(error, ToolkitError) else repr(error)
                # Report once: the same error occurs after every edit.
                if self._reported.get(key) != text:
                    self._reported[key] = text
                    self._tell(f"{key}: {text}", "warning")
            else:
                self._reported.pop(key, None)
                self._finish(finish, result)

        self._runner.submit_aside(key, task, lambda: work(task), done, delay=delay)

    def cancel_aside(self, *keys: str) -> None:
        """Cancel the automatic updates with these keys."""
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
