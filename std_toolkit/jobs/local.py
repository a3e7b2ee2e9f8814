"""Items over processes of this machine. A worker that dies takes down no more than its item."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from std_toolkit.jobs.runner import JobOptions, Outcome

# An item whose worker dies (killed, out of memory, abort in a library) is tried this often.
ATTEMPTS = 3


def run_locally(
    call: Callable[[Any], Outcome[Any]], items: Sequence[Any], options: JobOptions
) -> Iterator[tuple[int, Outcome[Any]]]:
    """See `runner.EngineRunner`."""
    pending = list(range(len(items)))
    attempts = dict.fromkeys(pending, 0)
    width = min(options.worker_count, len(items))
    while pending:
        finished: set[int] = set()
        started: set[int] = set()
        # forkserver: forking a process that holds threads or a GL context may deadlock.
        context = multiprocessing.get_context("forkserver")
        with ProcessPoolExecutor(width, mp_context=context) as pool:
            queue = iter(pending)
            running: dict[Future[Outcome[Any]], int] = {}
            try:
                while True:
                    # Submit little more than what runs, so that a crash has few suspects.
                    while len(running) < width and (index := next(queue, None)) is not None:
                        started.add(index)
                        running[pool.submit(call, items[index])] = index
                    if not running:
                        break
                    done, _ = wait(running, return_when=FIRST_COMPLETED)
                    for future in done:
                        index = running.pop(future)
                        outcome = future.result()
                        finished.add(index)
                        yield index, outcome
            except BrokenProcessPool:
                pass
            except GeneratorExit:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        suspects = started - finished
        for index in suspects:
            attempts[index] += 1
        pending = [i for i in pending if i not in finished]
        for index in [i for i in pending if attempts[i] >= ATTEMPTS]:
            pending.remove(index)
            yield index, Outcome(error=f"its worker process died {ATTEMPTS} times")
        if suspects:
            # One at a time tells the item that kills from its neighbours.
            width = 1
