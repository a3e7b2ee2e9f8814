"""Pickled arrays and plain containers, read without running anything that the file names.

A pickle is a program: it may call any function that can be imported. Here it can name NumPy's
arrays, scalars and types alone, which are made from their bytes by code of this module; the
interpreter is Python's own in Python, whose memory does not grow with the numbers in the file.
"""

import io
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.io.regular import MIB, read_regular

LARGEST_BYTES = 64 * MIB
_KINDS = "biufSU"
_MODULES = (
    "numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy._core.numeric",
    "numpy.core.numeric", "_codecs", "builtins", "__builtin__",
)  # fmt: skip


def read_plain_pickle(path: Path) -> Any:
    """Read a pickle of arrays of numbers, scalars, text, lists, tuples, sets and dictionaries.

    Args:
        path: of the file.

    Returns:
        The value, with NumPy arrays and scalars.

    Raises:
        ToolkitError: unreadable, larger than 64 MB, damaged, or it names anything else: nothing of
            it was run.
    """
    data = read_regular(path, "pickle", LARGEST_BYTES)
    try:
        return _finished(_Plain(io.BytesIO(data)).load())
    except ToolkitError as error:
        raise error.revised(path=path) from error
    except Exception as error:  # a damaged program can fail in any way
        line = " ".join(str(error).split())[:160]
        raise ToolkitError(f"not a pickle of plain values: {line}", path=path) from error


class _Plain(pickle._Unpickler):
    """Python's own interpreter, which looks names up here and nowhere else."""

    def find_class(self, module: str, name: str) -> Callable[..., Any]:
        known = _NAMES.get(name) if module in _MODULES else None
        if known is None:
            raise ToolkitError(
                "the pickle names what is no plain value; it was not run",
                value=f"{module}.{name}"[:100],
            )
        return known

    def persistent_load(self, pid: Any) -> NoReturn:  # noqa: ARG002
        raise ToolkitError("the pickle refers to something outside of the file")

    def get_extension(self, code: int) -> NoReturn:
        raise ToolkitError("the pickle names an extension; it was not run", value=code)


class _Type:
    """A type of numbers or text that is about to be made."""

    def __init__(self, text: Any, *_: Any) -> None:
        text = text.decode("ascii") if isinstance(text, bytes) else text
        found = np.dtype(text if isinstance(text, str) else "O")
        if found.kind not in _KINDS:
            raise ToolkitError("the pickle holds arrays that are no numbers", value=str(text)[:40])
        self.dtype = found

    def __setstate__(self, state: Any) -> None:
        if len(state) > 3 and any(part is not None for part in state[2:5]):
            raise ToolkitError("the pickle holds arrays of records")
        order = state[1]
        order = order.decode("ascii") if isinstance(order, bytes) else order
        if order in ("<", ">"):
            self.dtype = self.dtype.newbyteorder("<" if order == "<" else ">")


class _Array:
    """An array that is about to be made."""

    value: np.ndarray | None = None

    def __init__(self, *_: Any) -> None:
        pass

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, fortran, data = state
        self.value = _from_bytes(data, kind, tuple(shape), "F" if fortran else "C")


def _from_bytes(data: Any, kind: Any, shape: tuple[int, ...], order: Any) -> np.ndarray:
    data = data.encode("latin1") if isinstance(data, str) else bytes(data)
    count = math.prod(shape)
    if min(shape, default=0) < 0 or count * kind.dtype.itemsize != len(data):
        raise ToolkitError("the pickle is damaged: an array of another number of bytes")
    return np.frombuffer(data, kind.dtype).reshape(shape, order=order).copy()


def _buffer(data: Any, kind: Any, shape: Any, order: Any = "C") -> np.ndarray:
    return _from_bytes(data, kind, tuple(shape), "F" if order == "F" else "C")


def _scalar(kind: Any, data: Any) -> Any:
    return _from_bytes(data, kind, (1,), "C")[0]


def _encode(text: str, codec: str = "latin1") -> bytes:
    if codec != "latin1":  # that of bytes in the pickles of Python 2; others may do anything
        raise ToolkitError("the pickle names a codec", value=str(codec)[:40])
    return text.encode("latin1")


def _bytes() -> bytes:
    """Empty bytes, which old pickles make by a call; a call with a number could ask for memory."""
    return b""


_NAMES: dict[str, Callable[..., Any]] = {
    "_reconstruct": _Array,
    "ndarray": _Array,
    "dtype": _Type,
    "scalar": _scalar,
    "_frombuffer": _buffer,
    "encode": _encode,
    "bytes": _bytes,
    "set": set,
    "frozenset": frozenset,
}


def _finished(value: Any) -> Any:
    """Arrays in the place of what is about to be one."""
    if isinstance(value, _Array):
        if value.value is None:
            raise ToolkitError("the pickle is damaged: an array without content")
        return value.value
    if isinstance(value, dict):
        return {_finished(k): _finished(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return type(value)(_finished(v) for v in value)
    if isinstance(value, bool | int | float | complex | str | bytes | np.generic | np.ndarray):
        return value
    if value is None:
        return None
    raise ToolkitError("the pickle holds no plain value", value=type(value).__name__)
