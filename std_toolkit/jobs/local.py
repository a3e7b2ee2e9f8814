"""Items over processes of this machine. A worker that dies takes down no more than its item."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from multiprocessing import connection
from typing import Any

from std_toolkit.jobs.runner import ATTEMPTS, JobOptions, Outcome, error_of, worker_died

Call = Callable[[Any], Outcome[Any]]


def run_locally(
    call: Call, items: Sequence[Any], options: JobOptions
) -> Generator[tuple[int, Outcome[Any]]]:
    """See `runner.EngineRunner`.

    After a crash, the few items that were running are suspects: each is tried again alone, which
    tells the item that kills from its neighbours; then the work goes on at full width.
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
            # Submit only what runs: lists may be long, and a crash then has few suspects.
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
    # Ctrl-C goes to the whole process group; the parent decides what becomes of its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Every library would start as many threads as there are cores, in every worker.
    threads = str(max(1, len(os.sched_getaffinity(0)) // width))
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(variable, threads)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    # A worker of a killed parent would otherwise wait for work until the machine is restarted.
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
