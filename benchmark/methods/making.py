"""Making a method of any kind from its name: what can go wrong is one line that says where."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry

T = TypeVar("T")


def make_of(
    registry: Registry[Callable[[Any], T]],
    name: str,
    options: object,
    *,
    called: str,
    has: Sequence[str] = (),
    guide: str,
) -> T:
    """A method by its name, or by `package.module:Class`.

    Args:
        registry: of its kind.
        name: which one.
        options: what its class takes.
        called: the method that it must have.
        has: attributes that it must have.
        guide: the page that shows how one is written.

    Raises:
        ToolkitError: no such method, one that lacks a part, or what it says of its options.
    """
    factory = registry.get(name)
    if not callable(factory):
        raise ToolkitError(
            "is not a class that takes MethodOptions", value=name, hint=f"{guide} shows one"
        )
    try:
        method = factory(options)
    except (ToolkitError, MemoryError):
        raise
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise ToolkitError(
            f"the method cannot be made: {type(error).__name__}: {' '.join(str(error).split())}",
            value=name,
            hint=f"raised in {place.filename}, line {place.lineno}",
        ) from error
    absent = [part for part in has if not hasattr(method, part)]
    absent += [] if callable(getattr(method, called, None)) else [called]
    if absent:
        raise ToolkitError(
            "the method has no such attribute",
            field=", ".join(absent),
            value=name,
            hint=f"{guide} tells what a method must have",
        )
    return method
