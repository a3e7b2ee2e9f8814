"""Outcomes of items and their errors, shared by all job engines."""

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from std_toolkit.errors import ToolkitError, missing_extra
from std_toolkit.plugins import error_of_plugin

Item = TypeVar("Item")


Result = TypeVar("Result")


# Attempts for an item whose worker dies (killed, out of memory, abort in a library).
ATTEMPTS = 3


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
    error = missing_extra(error) or error_of_plugin(error, in_use=True) or error
    if isinstance(error, ToolkitError):
        return Outcome(error=str(error))
    return Outcome(error=f"{type(error).__name__}: {' '.join(str(error).split())[:500]}")
