"""Functions compiled to machine code."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """The function compiled by numba when it is first called with new types of arguments.

    It releases the interpreter's lock, so that Python's threads run it side by side; numba's own
    threads may not outlive a fork. The machine code is kept beside the source, or in the user's
    cache where nothing may be written there.
    """
    return cast(F, numba.njit(nogil=True, cache=True)(function))
