"""Functions compiled to machine code."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from std_toolkit.errors import ToolkitError

try:
    import numba
except ModuleNotFoundError as error:
    raise ToolkitError(
        f"the compiler of the sensors' inner loops is not installed: {error}",
        hint="pip install 'std-toolkit[sim]'",
    ) from error

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """The function compiled by numba when it is first called with new types of arguments.

    It releases the interpreter's lock, so that Python's threads run it side by side; numba's own
    threads may not outlive a fork. The machine code is kept beside the source, or in the user's
    cache where nothing may be written there; where neither can be, it is made anew each time.
    """
    try:
        return cast(F, numba.njit(nogil=True, cache=True)(function))
    except RuntimeError:  # no place for a cache
        return cast(F, numba.njit(nogil=True)(function))
