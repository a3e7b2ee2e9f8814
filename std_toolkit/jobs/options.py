"""Options, item outcomes and errors shared by all job engines."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Annotated, Any, Generic, Literal, TypeVar

import msgspec

from std_toolkit.errors import ToolkitError, check_options, missing_extra

Item = TypeVar("Item")


Result = TypeVar("Result")


Engine = Literal["local", "serial", "ray"]


# Attempts for an item whose worker dies (killed, out of memory, abort in a library).
ATTEMPTS = 3


@dataclass(frozen=True, kw_only=True)
class JobOptions:
    """Where work runs and how much of it in parallel."""

    engine: Engine = "local"
    """local (processes on this machine), serial (this process) or ray (needs extra `cluster`)"""
    workers: Annotated[int, msgspec.Meta(ge=1)] | None = None
    """number of parallel processes or Ray tasks (default: the usable cores)"""
    ray_address: str | None = None
    """host:port of a running Ray cluster (default: start one on this machine)"""
    gpus: Annotated[float, msgspec.Meta(ge=0)] = field(default=0.0, metadata={"option": None})
    """GPUs that Ray reserves for each task, which sees only these; may be fractional"""
    progress: bool = field(default=True, metadata={"option": None})
    """show a progress bar if stderr is a terminal"""

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def worker_count(self) -> int:
        """Number of processes: `workers`, or one for each core that this process may use."""
        return self.workers or usable_cores()


def usable_cores() -> int:
    """Cores that this process may use; those of the machine where the system does not say."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS, Windows


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """Outcome of one item: a result, or the error as one line."""

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
    error = missing_extra(error) or error
    if isinstance(error, ToolkitError):
        return Outcome(error=str(error))
    return Outcome(error=f"{type(error).__name__}: {' '.join(str(error).split())[:500]}")
