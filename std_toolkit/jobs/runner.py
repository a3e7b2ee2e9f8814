"""A typed function over a list of items: progress, failures collected, crashed workers retried.

Items are idempotent: they skip finished work and write atomically. A job that is run again after
an interruption therefore resumes.

The local engine runs items in processes of this machine. A worker that dies fails only its item.
The pool is Python's `ProcessPoolExecutor`, recreated after a crash. pebble, which replaces single
workers, hangs on an item that ends its process with status 0, and on all items after a worker was
killed while it sent its result.
"""

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, field
from multiprocessing import connection
from typing import Any, Generic, Protocol

from std_toolkit.errors import ToolkitError, is_interrupt
from std_toolkit.jobs.memory import keep_freed_memory
from std_toolkit.jobs.outcome import ATTEMPTS, Item, Outcome, Result, error_of, worker_died
from std_toolkit.log import logger
from std_toolkit.options import JobOptions, usable_cores
from std_toolkit.plugins import naming_document, take_names_of
from std_toolkit.settings import Settings, in_force, use_only

Call = Callable[[Any], Outcome[Any]]

_LINE_S = 5.0
"""Where there is no terminal for a progress bar, at least this time lies between two lines."""


@dataclass
class JobReport(Generic[Result]):
    """Summary of a job.

    Attributes:
        name: of the job.
        results: by item key, for items that succeeded, in item order.
        failed: error line by item key.
    """

    name: str
    results: dict[str, Result] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def raise_if_failed(self) -> None:
        """Raise one error that lists the failed items, if any.

        Raises:
            ToolkitError: at least one item failed.
        """
        if self.failed:
            total = len(self.failed) + len(self.results)
            shown = "; ".join(f"{k}: {e}" for k, e in list(self.failed.items())[:3])
            more = f"; and {len(self.failed) - 3} more" if len(self.failed) > 3 else ""
            raise ToolkitError(f"{self.name}: {len(self.failed)} of {total} failed: {shown}{more}")


class EngineRunner(Protocol):
    """Runs `call` on every item and yields (index, outcome) in any order."""

    def __call__(
        self, call: Callable[[Any], Outcome[Any]], items: Sequence[Any], options: JobOptions
    ) -> Generator[tuple[int, Outcome[Any]]]: ...


def run_jobs(
    fn: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    name: str,
    key: Callable[[Item], str] = str,
    options: JobOptions | None = None,
    keep: Callable[[Result], Result] | None = None,
) -> JobReport[Result]:
    """Run `fn` on every item; an item that fails does not stop the run.

    A script that calls this at its top level needs `if __name__ == "__main__":`, because worker
    processes import the script.

    Args:
        fn: picklable: a top-level function or a `functools.partial` of one.
        items: picklable work items.
        name: shown in the progress bar and in errors.
        key: name of an item in the report; must be unique.
        options: engine and number of workers.
        keep: called in this process with each result as it arrives, in any order; what it returns
            is in the report in place of the result, which may be too large to keep.

    Returns:
        Results in item order, and the failures. The caller decides whether failures are fatal.

    Raises:
        ToolkitError: two items have one key, or the engine cannot be started.
        KeyboardInterrupt: at once; items that were running are killed, not waited for.
    """
    from tqdm import tqdm

    options = options or JobOptions()
    keys = [key(item) for item in items]
    if len(set(keys)) != len(keys):
        twice = next(k for i, k in enumerate(keys) if k in keys[:i])
        raise ToolkitError(f"{name}: two items have the same name", value=twice)
    outcomes: dict[int, Outcome[Result]] = {}
    call = _Guarded(fn)
    shown = None if options.progress else True  # None: only on a terminal
    engine = _engine(options, len(items))
    with (
        tqdm(total=len(items), desc=name, unit="item", disable=shown) as bar,
        # Closed at once when interrupted: the traceback would keep the workers alive.
        closing(engine(call, items, options)) as stream,
    ):
        began = told = time.monotonic()
        failed = 0
        for index, outcome in stream:
            if keep is not None and outcome.error is None:
                outcome = Outcome(result=keep(outcome.result))  # type: ignore[arg-type]
            outcomes[index] = outcome
            bar.update()
            if outcome.error is not None:
                failed += 1
                # At once: the others may fail for the same reason, and it is time to stop.
                bar.clear()
                logger.error("%s: %s: %s", name, keys[index], outcome.error)
                bar.set_postfix_str(f"{failed} failed")
            now = time.monotonic()
            if options.progress and bar.disable and now - told >= _LINE_S:
                told = now
                # Items that fail early say nothing about the time of the others.
                left = (now - began) / max(len(outcomes) - failed, 1) * (len(items) - len(outcomes))
                logger.info(
                    "%s: %s %s, %d of %d%s, about %s left",
                    name,
                    keys[index],
                    "done" if outcome.error is None else "failed",
                    len(outcomes),
                    len(items),
                    f" ({failed} failed)" if failed else "",
                    _duration(left),
                )
    report: JobReport[Result] = JobReport(name)
    for index, item_key in enumerate(keys):
        outcome = outcomes[index]
        if outcome.error is not None:
            report.failed[item_key] = outcome.error
        else:
            report.results[item_key] = outcome.result  # type: ignore[assignment]
    return report


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    if minutes < 1:
        return f"{seconds:.0f} s"
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"


def inherited() -> tuple[tuple[Settings, ...], str | None]:
    """What a process that is started must know of this one: the arguments of `inherit`."""
    return in_force(), naming_document()


def inherit(limits: Sequence[Settings], document: str | None) -> None:
    """Use the limits of the starting process, and refuse code where it refuses code."""
    use_only(limits)
    take_names_of(document)


class _Guarded(Generic[Item, Result]):
    """`fn` as in this process, its exceptions turned into outcomes; can be pickled."""

    def __init__(self, fn: Callable[[Item], Result]) -> None:
        self.fn = fn
        self.inherited = inherited()

    def __call__(self, item: Item) -> Outcome[Result]:
        inherit(*self.inherited)
        try:
            return Outcome(result=self.fn(item))
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException as error:
            if is_interrupt(error):
                raise KeyboardInterrupt from error
            # A library that calls exit() or panics fails its item, not the run.
            logger.debug("failed item", exc_info=True)
            return error_of(error)


def _engine(options: JobOptions, count: int) -> EngineRunner:
    if options.engine == "ray":
        from std_toolkit.jobs.ray_engine import run_on_ray

        return run_on_ray
    if options.engine == "serial" or count <= 1:  # one item cannot harm others
        return _run_serially

    return run_locally


def _run_serially(
    call: Callable[[Any], Outcome[Any]],
    items: Sequence[Any],
    options: JobOptions,  # noqa: ARG001 - part of the protocol
) -> Generator[tuple[int, Outcome[Any]]]:
    for index, item in enumerate(items):
        yield index, call(item)


def run_locally(
    call: Call, items: Sequence[Any], options: JobOptions
) -> Generator[tuple[int, Outcome[Any]]]:
    """See `runner.EngineRunner`.

    After a crash, each item that was running is tried again alone, which identifies the item that
    kills its worker. The work then continues in parallel.
    """
    width = min(options.worker_count, len(items))
    queue = iter(range(len(items)))
    suspects: deque[int] = deque()
    more = True
    while more:
        more = False
        with closing(_pool(call, items, queue, width)) as outcomes:
            for index, outcome in outcomes:
                if outcome is None:
                    suspects.append(index)
                    more = True
                else:
                    yield index, outcome
        while suspects:
            index = suspects.popleft()
            yield index, _alone(call, items, index)


def _alone(call: Call, items: Sequence[Any], index: int) -> Outcome[Any]:
    for _ in range(ATTEMPTS - 1):
        for _, outcome in _pool(call, items, iter([index]), 1):
            if outcome is not None:
                return outcome
    return worker_died()


def _pool(
    call: Call, items: Sequence[Any], queue: Iterator[int], width: int
) -> Generator[tuple[int, Outcome[Any] | None]]:
    """Outcomes from one pool until the queue is empty or a worker died.

    None stands for an item that was running when a worker died.
    """
    # forkserver: forking a process that holds threads or a GL context may deadlock.
    context = multiprocessing.get_context("forkserver")
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        width, mp_context=context, initializer=_prepare_worker, initargs=(width,)
    )
    running: dict[Future[Outcome[Any]], int] = {}
    finished = False
    try:
        broken = False
        while True:
            # Submit only what runs: lists may be long, and few items are then retried after a
            # crash.
            while not broken and len(running) < width:
                index = next(queue, None)
                if index is None:
                    break
                try:
                    running[pool.submit(call, items[index])] = index
                except BrokenProcessPool:
                    broken = True
                    yield index, None
            if not running:
                break
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                index = running.pop(future)
                error = future.exception()
                if error is None:
                    yield index, future.result()
                elif isinstance(error, BrokenProcessPool):
                    broken = True
                    yield index, None
                else:  # the item or its result cannot be sent between processes
                    yield index, error_of(error)
        finished = True
    finally:
        if not finished:
            # Interrupted: waiting for the running items could take minutes. They lose nothing,
            # because every write is atomic.
            for child in set(multiprocessing.active_children()) - before:
                child.kill()
        pool.shutdown(wait=True, cancel_futures=True)


def _prepare_worker(width: int) -> None:
    """Runs first in every worker process, before any heavy library is imported there."""
    # Ctrl-C goes to the whole process group; the parent ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Every library would start as many threads as there are cores, in every worker.
    threads = str(max(1, usable_cores() // width))
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(variable, threads)
    keep_freed_memory()
    die_with_parent()


def die_with_parent() -> None:
    """End this worker process when its parent ends; it would otherwise wait for work forever."""

    def wait_for_end() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            connection.wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=wait_for_end, daemon=True).start()
