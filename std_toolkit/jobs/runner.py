"""A typed function over a list of items: progress, failures collected, crashed workers retried.

Steps make their items idempotent (skip what is done, write atomically), so that running a job
again after any interruption goes on where it stopped.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, Protocol, TypeVar

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

Item = TypeVar("Item")
Result = TypeVar("Result")
Engine = Literal["local", "serial", "ray"]
ENGINES: tuple[Engine, ...] = ("local", "serial", "ray")
# An item whose worker dies (killed, out of memory, abort in a library) is tried this often.
ATTEMPTS = 3


@dataclass(frozen=True, kw_only=True)
class JobOptions:
    """Where and how widely work runs.

    Attributes:
        engine: "local" processes, "serial" in this process, or "ray" (extra `[cluster]`).
        workers: number of processes or Ray tasks at a time; default: the usable cores.
        ray_address: of a running cluster; default: start one on this machine.
        gpus: GPUs that Ray sets aside for each task, which then sees no others; may be a share.
        progress: show a progress bar when stderr is a terminal.
    """

    engine: Engine = "local"
    workers: int | None = None
    ray_address: str | None = None
    gpus: float = 0.0
    progress: bool = True

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise ToolkitError("unknown engine", value=self.engine, hint=f"one of {ENGINES}")
        if self.workers is not None and self.workers < 1:
            raise ToolkitError("must be at least 1", field="workers", value=self.workers)
        if not self.gpus >= 0:
            raise ToolkitError("must not be negative", field="gpus", value=self.gpus)

    @property
    def worker_count(self) -> int:
        return self.workers or len(os.sched_getaffinity(0))


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """What became of one item: a result, or the error as one line."""

    result: Result | None = None
    error: str | None = None


def worker_died() -> Outcome[Any]:
    """The outcome of an item that killed its worker process every time."""
    return Outcome(
        error=f"its worker process died {ATTEMPTS} times (killed, out of memory, or started from a "
        'script that lacks `if __name__ == "__main__":`)'
    )


def error_of(error: BaseException) -> Outcome[Any]:
    """The outcome of an item that raised `error`."""
    if isinstance(error, ToolkitError):
        return Outcome(error=str(error))
    return Outcome(error=f"{type(error).__name__}: {' '.join(str(error).split())[:500]}")


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
) -> JobReport[Result]:
    """Run `fn` on every item; one bad item never ends the run.

    A script that calls this at its top level needs Python's usual
    `if __name__ == "__main__":`, because worker processes import the script.

    Args:
        fn: picklable: a top-level function or a `functools.partial` of one.
        items: picklable work items.
        name: shown in the progress bar and in errors.
        key: name of an item in the report; must be unique.
        options: engine and width.

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
        for index, outcome in stream:
            outcomes[index] = outcome
            bar.update()
    report: JobReport[Result] = JobReport(name)
    for index, item_key in enumerate(keys):
        outcome = outcomes[index]
        if outcome.error is not None:
            report.failed[item_key] = outcome.error
            logger.error("%s: %s: %s", name, item_key, outcome.error)
        else:
            report.results[item_key] = outcome.result  # type: ignore[assignment]
    return report


class _Guarded(Generic[Item, Result]):
    """`fn` with its exceptions turned into outcomes, so that they cross process borders."""

    def __init__(self, fn: Callable[[Item], Result]) -> None:
        self.fn = fn

    def __call__(self, item: Item) -> Outcome[Result]:
        try:
            return Outcome(result=self.fn(item))
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException as error:
            # The job layer is where one item's failure is handled; a library that calls exit()
            # or panics fails its item, not the run.
            logger.debug("failed item", exc_info=True)
            return error_of(error)


def _engine(options: JobOptions, count: int) -> EngineRunner:
    if options.engine == "ray":
        from std_toolkit.jobs.ray_engine import run_on_ray

        return run_on_ray
    if options.engine == "serial" or count <= 1:  # one item has no neighbours to protect
        return _run_serially
    from std_toolkit.jobs.local import run_locally

    return run_locally


def _run_serially(
    call: Callable[[Any], Outcome[Any]],
    items: Sequence[Any],
    options: JobOptions,  # noqa: ARG001 - part of the protocol
) -> Generator[tuple[int, Outcome[Any]]]:
    for index, item in enumerate(items):
        yield index, call(item)
