"""Work beside the front end: the newer replaces the older, and nothing comes after the end."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any

from annotator.app.tasks import Task, ThreadRunner


class Loop:
    """An event loop in the test's hands."""

    def __init__(self) -> None:
        self.calls: queue.Queue[Callable[[], None]] = queue.Queue()
        self.runner = ThreadRunner(self.calls.put)
        self.done: list[tuple[Any, Exception | None]] = []

    def note(self, result: Any, error: Exception | None) -> None:
        assert threading.current_thread() is threading.main_thread()
        self.done.append((result, error))

    def hold(self) -> threading.Event:
        """Start work that goes on until the event is set."""
        began, go_on = threading.Event(), threading.Event()

        def work() -> None:
            began.set()
            go_on.wait(10)

        self.runner.submit(Task("held"), work, self.note)
        assert began.wait(10)
        return go_on

    def turn(self, times: int = 1) -> None:
        for _ in range(times):
            self.calls.get(timeout=10)()


def test_results_come_back_into_the_thread_of_the_loop() -> None:
    loop = Loop()
    loop.runner.submit(Task("x"), threading.current_thread, loop.note)
    loop.turn()
    ((thread, error),) = loop.done
    assert error is None
    assert thread is not threading.main_thread()
    assert loop.runner.close()


def test_an_exception_comes_back_too_and_the_thread_goes_on() -> None:
    loop = Loop()
    loop.runner.submit(Task("x"), lambda: 1 / 0, loop.note)
    loop.runner.submit(Task("y"), lambda: 2, loop.note)
    loop.turn(2)
    assert isinstance(loop.done[0][1], ZeroDivisionError)
    assert loop.done[1] == (2, None)
    assert loop.runner.close()


def test_of_a_burst_of_one_kind_the_last_alone_is_done() -> None:
    loop = Loop()
    tasks = [Task(str(i)) for i in range(5)]
    for i, task in enumerate(tasks):
        loop.runner.submit_aside("key", task, lambda i=i: i, loop.note, delay=0.05)  # type: ignore[misc]
    loop.turn()
    assert loop.done == [(4, None)]
    assert [t.cancelled for t in tasks] == [True] * 4 + [False]
    assert loop.runner.close()
    assert loop.calls.empty()


def test_a_result_that_newer_work_has_overtaken_is_dropped() -> None:
    loop = Loop()
    began, go_on = threading.Event(), threading.Event()

    def slow() -> str:
        began.set()
        go_on.wait(10)
        return "old"

    loop.runner.submit_aside("key", Task("old"), slow, loop.note)
    assert began.wait(10)
    loop.runner.submit_aside("key", Task("new"), lambda: "new", loop.note)
    go_on.set()
    loop.turn(2)
    assert loop.done == [("new", None)]
    assert loop.runner.close()


def test_what_runs_aside_does_not_hold_up_what_a_person_started() -> None:
    loop = Loop()
    go_on = threading.Event()
    loop.runner.submit_aside("key", Task("aside"), lambda: go_on.wait(10), loop.note)
    loop.runner.submit(Task("first"), lambda: "first", loop.note)
    loop.turn()
    assert loop.done == [("first", None)]
    go_on.set()
    assert loop.runner.close()


def test_nothing_is_delivered_after_the_end() -> None:
    loop = Loop()
    go_on = loop.hold()
    threading.Timer(0.2, go_on.set).start()
    assert loop.runner.close(timeout=10)
    loop.runner.submit(Task("y"), lambda: 1, loop.note)
    while not loop.calls.empty():
        loop.turn()
    assert loop.done == []


def test_a_thread_that_does_not_end_is_told() -> None:
    loop = Loop()
    go_on = loop.hold()
    assert not loop.runner.close(timeout=0.05)
    go_on.set()
