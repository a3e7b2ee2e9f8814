"""Functions compiled to machine code by numba."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

from std_toolkit.log import logger

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F, **options: Any) -> F:
    """The function compiled by numba when it is first called with new types of arguments.

    It releases the GIL, so that Python threads run it in parallel; numba's own threads may not
    survive a fork. The machine code is cached beside the source, or in the user's cache folder if
    the source folder is read-only; if neither is writable, each process compiles it.

    Args:
        function: to compile.
        options: of `numba.njit`, such as error_model="numpy", without which divisions are checked
            one by one.
    """
    try:
        dispatcher: Any = numba.njit(nogil=True, cache=True, **options)(function)
    except RuntimeError:  # no place for a cache
        return cast(F, numba.njit(nogil=True, **options)(function))
    # On a full disk the code that was just compiled still runs. Numba has no public hook for it.
    cache = dispatcher._cache
    save = cache.save_overload

    def save_overload(signature: Any, result: Any) -> None:
        try:
            save(signature, result)
        except OSError as error:
            logger.warning("%s: compiled code is not kept: %s", cache.cache_path, error.strerror)

    cache.save_overload = save_overload
    return cast(F, dispatcher)
