"""Pickles of plain values and arrays, read without running anything that they name.

Nothing of a pickle is imported or called: names of NumPy stand for classes of this module, which
become arrays of numbers after their sizes are checked, and records that the caller names become
dicts of their fields; any other name is refused.
"""

import importlib
import io
import math
import pickle
import pickletools
import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError, located
from std_toolkit.io.bounded_bags import unpacker_of
from std_toolkit.io.regular import open_regular_file

# Pickles of a frame's poses have under 100 kB.
_LARGEST_BYTES = 64 * 2**20
_MOST_STEPS = 2_000_000
_MOST_BITS = 64  # of a whole number
_MOST_SIDES = 32  # of an array
_KIND = re.compile(r"[<>=|]?[biufSU?]\d{0,4}")
_NUMBERS = "biuf"
_DEEPEST_LIST = 4
_MOST_NUMBERS = 1_000_000
# Steps that call something other than what a name stands for, and sets: what is in one is hashed,
# which takes a time that doubles with each level of tuples.
_REFUSED = frozenset({
    "PERSID", "BINPERSID", "EXT1", "EXT2", "EXT4", "INST", "OBJ", "NEWOBJ_EX", "NEXT_BUFFER",
    "EMPTY_SET", "ADDITEMS", "FROZENSET",
})  # fmt: skip
_KEYS = (str, bytes, int, float, type(None))


class _Kind:
    """Stands for `numpy.dtype`."""

    def __init__(self, text: Any, *_: Any) -> None:
        if not isinstance(text, str):
            raise ValueError("an array of something else")
        if not _KIND.fullmatch(text):
            raise ValueError(f"an array of {text[:20]!r}")
        self.text, self.order = text.lstrip("<>=|"), "<"

    def __setstate__(self, state: Any) -> None:
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else "<"
        self.order = ">" if order == ">" else "<"

    def dtype(self) -> np.dtype[Any]:
        return np.dtype(self.order + self.text)


class _Array:
    """Stands for an array; `state` is (version, shape, kind, Fortran order, bytes)."""

    state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def array(self) -> NDArray[Any]:
        _, shape, kind, fortran, data = self.state
        return _array(shape, kind, "F" if fortran else "C", data)


class _Numpy:
    """Stands for the class `numpy.ndarray`, which only `_begin` is given."""


def _array(shape: Any, kind: Any, order: Any, data: Any) -> NDArray[Any]:
    data = data.encode("latin-1") if isinstance(data, str) else data  # of Python 2
    if not isinstance(kind, _Kind) or not isinstance(data, bytes | bytearray):
        raise ValueError("an array of objects")
    if len(shape) > _MOST_SIDES:
        raise ValueError("an array of too many sides")
    sizes = tuple(int(n) for n in shape)
    dtype = kind.dtype()
    if min(sizes, default=0) < 0 or math.prod(sizes) * dtype.itemsize != len(data):
        raise ValueError("an array of another size than its bytes")
    order = "F" if order == "F" else "C"
    return np.frombuffer(data, dtype).reshape(sizes, order=order)


def _begin(*_: Any) -> _Array:
    return _Array()


def _from_buffer(data: Any, kind: Any, shape: Any, order: Any = "C") -> NDArray[Any]:
    return _array(shape, kind, order, data)


def _scalar(kind: Any, data: Any) -> Any:
    return _array((), kind, "C", data)[()]


def _bytes(data: Any = b"", *_: Any) -> bytes:
    if not isinstance(data, bytes | bytearray):  # a number would reserve as many
        raise ValueError("bytes of something else")
    return bytes(data)


def _encoded(text: Any, _: Any) -> bytes:
    if not isinstance(text, str):
        raise ValueError("bytes of something else")
    return text.encode("latin-1")


def _ordered(pairs: Any = ()) -> dict[Any, Any]:
    found: dict[Any, Any] = {}
    for key, value in pairs:
        _put(found, key, value)
    return found


def _put(into: Any, key: Any, value: Any) -> None:
    if type(into) is not dict or not isinstance(key, _KEYS):
        raise ValueError("a key that is neither a text nor a number")
    into[key] = value


_CORE = ("numpy.core", "numpy._core")
_NAMES: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): _Numpy,
    ("numpy", "dtype"): _Kind,
    ("collections", "OrderedDict"): _ordered,
    **{(m, n): _bytes for m in ("__builtin__", "builtins") for n in ("bytes", "bytearray")},
    ("_codecs", "encode"): _encoded,
    **{(f"{core}.multiarray", "_reconstruct"): _begin for core in _CORE},
    **{(f"{core}.multiarray", "scalar"): _scalar for core in _CORE},
    **{(f"{core}.numeric", "_frombuffer"): _from_buffer for core in _CORE},
}


class _Record(dict[str, Any]):
    """Stands for an object of another program: its fields."""

    def __init__(self, *_: Any) -> None:
        raise ValueError("a record that is called")  # plain records are filled, never called

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, dict) or not all(isinstance(key, str) for key in state):
            raise ValueError("a record without named fields")
        self.update(state)


class _Reader(pickle._Unpickler):
    """The unpickler that is written in Python, some of whose steps do less.

    That in C reserves memory for any number of a memo, sets attributes of anything, and follows
    tuples of tuples until its stack is full.
    """

    dispatch: ClassVar[dict[int, Any]] = dict(pickle._Unpickler.dispatch)
    stack: list[Any]
    pop_mark: Callable[[], list[Any]]

    def __init__(self, data: bytes, records: Collection[tuple[str, str]]) -> None:
        super().__init__(io.BytesIO(data), encoding="latin-1")
        self._records = records
        # A value that is named again and again would be copied as often.
        self._left = 2 * _LARGEST_BYTES

    def _spend(self, value: Any) -> None:
        if isinstance(value, str | bytes | bytearray):
            self._left -= len(value)
        elif isinstance(value, list | tuple | dict):
            self._left -= 16 * len(value)
        if self._left < 0:
            raise ValueError("copies of more than it holds")

    def _call(self) -> None:
        values = self.stack.pop()
        if not isinstance(values, tuple) or len(values) > _MOST_SIDES:
            raise ValueError("a call of something else")
        for value in values:
            self._spend(value)
        self.stack[-1] = self.stack[-1](*values)

    def _begin_record(self) -> None:
        self.stack.pop()
        if self.stack[-1] is not _Record:
            raise ValueError("a new object that is no record")
        self.stack[-1] = _Record.__new__(_Record)

    def _fill(self) -> None:
        state = self.stack.pop()
        self._spend(state)
        target = self.stack[-1]
        if not isinstance(target, _Kind | _Array | _Record):
            raise ValueError("fields of something else")
        target.__setstate__(state)

    def _put_item(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        _put(self.stack[-1], key, value)

    def _put_items(self) -> None:
        items = self.pop_mark()
        for key, value in zip(items[::2], items[1::2], strict=True):
            _put(self.stack[-1], key, value)

    def _dict(self) -> None:
        items = self.pop_mark()
        self.stack.append(_ordered(zip(items[::2], items[1::2], strict=True)))

    dispatch |= {
        pickle.REDUCE[0]: _call, pickle.NEWOBJ[0]: _begin_record, pickle.BUILD[0]: _fill,
        pickle.SETITEM[0]: _put_item, pickle.SETITEMS[0]: _put_items, pickle.DICT[0]: _dict,
    }  # fmt: skip

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in self._records:
            return _Record
        found = _NAMES.get((module, name))
        if found is None:
            raise pickle.UnpicklingError(f"names {module}.{name}, which could run anything"[:160])
        return found

    def persistent_load(self, pid: Any) -> Any:  # noqa: ARG002
        raise pickle.UnpicklingError("refers to something outside")


def read_pickle(path: Path, *, records: Collection[tuple[str, str]] = ()) -> Any:
    """Read a pickle of numbers, texts, arrays of numbers, and lists, tuples and dicts of them.

    Arrays of the result are read-only, or stand in for arrays that `array_in` returns.

    Args:
        path: of the file, which may be packed with zstd; its name then ends with ".zstd".
        records: module and name of classes whose objects are read as dicts of their fields.

    Raises:
        ToolkitError: no such file, larger than 64 MB, damaged, or it names anything else: such a
            pickle could run any program, and is not read; or nothing here unpacks zstd.
    """
    try:
        with open_regular_file(path, "pickle", _LARGEST_BYTES) as file:
            data = file.read()
        if path.suffix == ".zstd":
            with located(path):
                data = unpacker_of(_zstd(), _LARGEST_BYTES)(data)
        # Looked at first: a length that lies reserves memory when it is read.
        for step, (code, value, _) in enumerate(pickletools.genops(data)):
            if code.name in _REFUSED or step > _MOST_STEPS:
                raise pickle.UnpicklingError(f"has the step {code.name}, number {step}")
            if isinstance(value, int) and value.bit_length() > _MOST_BITS:
                raise pickle.UnpicklingError(f"has a number of {value.bit_length()} bits")
        return _Reader(data, frozenset(records)).load()
    except ToolkitError:
        raise
    except Exception as error:  # of a damaged pickle: nearly any
        line = " ".join(str(error).split())[:200]
        raise ToolkitError(
            f"no pickle of plain values: {line}",
            path=path,
            hint="only numbers, texts, arrays of numbers, lists and dicts are read",
        ) from error


def _zstd() -> Callable[[], Any]:
    """The decompressor of Python 3.14, or of the package that brings it to older ones."""
    for name in ("compression.zstd", "backports.zstd"):
        try:
            make: Callable[[], Any] = importlib.import_module(name).ZstdDecompressor
        except ImportError:
            continue
        return make
    raise ToolkitError(
        "is packed with zstd, which this Python does not unpack", hint="pip install backports.zstd"
    )


def array_in(value: Any, path: Path, field: str) -> NDArray[np.float64]:
    """Return a value of `read_pickle` or `read_json` as an array of float64.

    Args:
        value: an array, a number, or lists of them of equal lengths, at most four levels deep.
        path, field: where it stands, for errors.

    Raises:
        ToolkitError: something else, or more than a million numbers.
    """
    try:
        left = [_MOST_NUMBERS]
        return np.array(_plain(value, _DEEPEST_LIST, left, whole=True), dtype=np.float64)
    except (ValueError, TypeError, OverflowError, IndexError) as error:
        raise ToolkitError("must be an array of numbers", path=path, field=field) from error


def _plain(value: Any, levels: int, left: list[int], *, whole: bool = False) -> Any:
    """Lists of numbers, or the `whole` array; `left` counts down how many may still come."""
    if isinstance(value, _Array):
        value = value.array()
    if isinstance(value, np.ndarray | np.generic):
        left[0] -= value.size
        if value.dtype.kind not in _NUMBERS or left[0] < 0:
            raise ValueError
        return value if whole else value.tolist()  # an empty array keeps its shape
    if isinstance(value, list | tuple):
        if not levels:
            raise ValueError
        left[0] -= len(value)
        if left[0] < 0:
            raise ValueError
        return [_plain(item, levels - 1, left) for item in value]
    if isinstance(value, int | float):
        return value
    raise ValueError
