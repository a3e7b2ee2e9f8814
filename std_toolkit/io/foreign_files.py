"""Reading arrays, JSON, YAML, TOML and CSV files of others, whatever they hold.

The readers of NumPy, PyYAML and csv trust their input: a header of a few bytes can ask for a
terabyte, aliases of YAML grow exponentially, and a long field raises an error without a file name.
"""

import csv
import json
import math
import os
import re
import struct
import tokenize
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import plain_integer, refuse_twice
from std_toolkit.io.regular import MIB, open_regular_file, read_text

T = TypeVar("T")

# Real YAML files of poses and cameras are below 100 kB and 10 levels.
_LARGEST_YAML_BYTES = 1024 * 1024
_DEEPEST_YAML = 40
_CONTROL = re.compile(r"[^\n\r\t\x20-\x7e\xa0-\U0010ffff]")
_LARGEST_JSON_BYTES = 16 * 1024 * 1024
_LARGEST_NPY_BYTES = 2**40
_LARGEST_UNPACKED_BYTES = 2**30
_RATIO = 20
_MOST_PARTS = 20
# A string, a comment or a long number; or one sign that parts keys, tables and values.
_TOML_SIGNS = re.compile(
    r'"""(?:[^\\]|\\.)*?(?:"""|\Z)|"(?:[^"\\\n]|\\.)*"|'
    r"'''.*?(?:'''|\Z)|'[^'\n]*'|#[^\n]*|"
    r"\b\d[\da-fA-F_]{40,}|[][{}=,.\n]",
    re.DOTALL,
)


def read_npy(path: Path) -> NDArray[Any]:
    """A .npy file with an array of numbers.

    Raises:
        ToolkitError: not found, not such a file, or not the number of bytes that its header says.
    """
    return _npy(path, lambda file, header: np.fromfile(file, header.dtype, header.count))


def mapped_npy(path: Path, records: np.dtype[Any] | None = None) -> NDArray[Any]:
    """A .npy file with an array of numbers, read from the disk where it is used; read-only.

    Args:
        records: type of the records that it must hold instead of numbers.

    Raises:
        ToolkitError: as `read_npy`.
    """

    def mapped(file: BinaryIO, header: _Header) -> NDArray[Any]:
        if not header.count:
            return np.empty(0, header.dtype)
        at = file.tell()
        return np.memmap(file, header.dtype, "r", offset=at, shape=(header.count,))

    return _npy(path, mapped, records)


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz file by name.

    Raises:
        ToolkitError: not found, no regular file, no such file, damaged, or it unpacks to more than
            a gigabyte and twenty times its size.
    """
    try:
        with open_regular_file(path, "arrays", _LARGEST_NPY_BYTES) as file:
            size = os.fstat(file.fileno()).st_size
            with zipfile.ZipFile(file) as archive:
                unpacked = sum(part.file_size for part in archive.infolist())
            if unpacked > max(_LARGEST_UNPACKED_BYTES, _RATIO * size):
                raise ToolkitError(
                    f"{size} bytes that unpack to {unpacked / MIB:.0f} MB", path=path
                )
            file.seek(0)
            with np.load(file, allow_pickle=False) as data:
                return {name: data[name] for name in data.files}
    except (
        *(ValueError, OSError, EOFError, TypeError, SyntaxError, RecursionError, MemoryError),
        *(OverflowError, LookupError, AttributeError, tokenize.TokenError, struct.error),
        *(zipfile.BadZipFile, zlib.error, RuntimeError),  # RuntimeError: encrypted
    ) as error:
        line = " ".join(str(error).split())
        raise ToolkitError(f"not arrays of numpy: {line[:200]}", path=path) from error


@dataclass(frozen=True)
class _Header:
    """Of a .npy file."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]

    @property
    def count(self) -> int:
        # Python's integers: the product of the sizes may be larger than 64 bits.
        return math.prod(self.shape)


def _npy(
    path: Path,
    load: Callable[[BinaryIO, _Header], NDArray[Any]],
    records: np.dtype[Any] | None = None,
) -> NDArray[Any]:
    try:
        with open_regular_file(path, "array", _LARGEST_NPY_BYTES) as file:
            header = _npy_header(file, path, records)
            found = load(file, header)
    except (
        *(ValueError, OSError, EOFError, TypeError, SyntaxError, RecursionError, MemoryError),
        *(OverflowError, LookupError, AttributeError, tokenize.TokenError, struct.error),
    ) as error:
        line = " ".join(str(error).split())
        raise ToolkitError(f"not a numpy array of numbers: {line[:200]}", path=path) from error
    return found.reshape(header.shape, order="F" if header.fortran else "C")


def _npy_header(file: BinaryIO, path: Path, records: np.dtype[Any] | None) -> _Header:
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0
    shape, fortran, dtype = (
        read(file) if version == (1, 0) else np.lib.format.read_array_header_2_0(file)
    )
    if dtype != records and (records is not None or dtype.kind not in "biuf"):
        raise ToolkitError("not a numpy array of numbers", path=path, value=str(dtype))
    header = _Header(tuple(int(n) for n in shape), bool(fortran), dtype)
    if min(header.shape, default=0) < 0:
        raise ToolkitError("the file is damaged: a negative size", path=path, value=header.shape)
    needed = header.count * dtype.itemsize
    held = os.fstat(file.fileno()).st_size - file.tell()
    if needed != held:
        raise ToolkitError(
            f"the file is damaged: its header needs {needed} bytes of numbers, it holds {held}",
            path=path,
            value="x".join(map(str, header.shape)) or "one number",
        )
    return header


def read_json(path: Path, *, largest_bytes: int = _LARGEST_JSON_BYTES) -> Any:
    """A JSON file of plain values.

    Raises:
        ToolkitError: unreadable, larger than `largest_bytes`, not JSON, nested too deeply, a key
            given twice, or a number of more digits than any reader keeps.
    """
    text = read_text(path, "JSON file", largest_bytes)
    try:
        return json.loads(text, object_pairs_hook=_unique_keys, parse_int=plain_integer)
    except ToolkitError as error:
        raise error.revised(path=path) from error
    except RecursionError as error:
        raise ToolkitError("not valid JSON: nested too deeply", path=path) from error
    except ValueError as error:
        raise ToolkitError(f"not valid JSON: {str(error)[:200]}", path=path) from error


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    refuse_twice(pairs)
    return dict(pairs)


def read_toml(path: Path, type_: type[T]) -> T:
    """A TOML file as a Struct, or whatever msgspec knows.

    Python's parser of TOML makes a table of each part of a dotted key, and copies the key for each:
    8,000 parts take half a gigabyte.

    Raises:
        ToolkitError: unreadable, larger than 1 MB, no TOML, nested deeper than 40 levels, a key of
            more than 20 parts, a control character, or a field of another type; the field is named.
    """
    text = read_text(path, "TOML file", _LARGEST_YAML_BYTES)
    _check_toml(text, path)
    try:
        values = tomllib.loads(text, parse_float=float)
        _refuse_control(values, path, "")
        return msgspec.convert(values, type_)
    except msgspec.ValidationError as error:
        problem, _, at = str(error).partition(" - at `$")
        raise ToolkitError(problem, path=path, field=at.strip("`.") or None) from error
    except ToolkitError as error:
        raise error.revised(path=path) from error
    except (ValueError, RecursionError) as error:  # also TOMLDecodeError
        line = " ".join(str(error).split())
        raise ToolkitError(f"no TOML: {line[:200]}", path=path) from error


def _refuse_control(value: Any, path: Path, field: str) -> None:
    """Refuse escapes of control characters: such words are printed, and would rewrite a terminal.

    The text itself cannot hold them, but line breaks and tabs.
    """
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_control(key, path, field)
            _refuse_control(item, path, f"{field}.{key}" if field else key)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _refuse_control(item, path, f"{field}[{index}]")
    elif isinstance(value, str) and _CONTROL.search(value):
        raise ToolkitError("holds a control character", path=path, field=field, value=value)


def _check_toml(text: str, path: Path) -> None:
    """Refuse deep nesting, long keys and long numbers outside of strings and comments."""
    depth = parts = 0
    for found in _TOML_SIGNS.finditer(text):
        sign = found[0]
        if sign[0].isdigit():
            line = text.count("\n", 0, found.start()) + 1
            raise ToolkitError("a number is implausibly long", path=path, field=f"line {line}")
        if len(sign) > 1:
            continue  # a string or a comment
        depth += (sign in "[{") - (sign in "]}")
        parts = parts + 1 if sign == "." else 0
        if depth > _DEEPEST_YAML or parts > _MOST_PARTS:
            line = text.count("\n", 0, found.start()) + 1
            problem = f"nested deeper than {_DEEPEST_YAML} levels"
            if depth <= _DEEPEST_YAML:
                problem = f"a key of more than {_MOST_PARTS} parts"
            raise ToolkitError(problem, path=path, field=f"line {line}")


def read_yaml(path: Path) -> Any:
    """A YAML file of plain values.

    Raises:
        ToolkitError: unreadable, not YAML, a key given twice, larger than 1 MB, nested deeper than
            40 levels, or with aliases.
    """
    import yaml  # type: ignore[import-untyped]

    text = read_text(path, "YAML file", _LARGEST_YAML_BYTES)
    try:
        loader = bounded_yaml_loader(text, path)
        node = yaml.compose(text, Loader=loader)
        if node is not None:
            _refuse_twice(node, path)
        return yaml.load(text, Loader=loader)
    except (
        *(yaml.YAMLError, ValueError, RecursionError, OverflowError),
        *(TypeError, AttributeError, LookupError),  # of odd scalars: times, keys that are lists
    ) as error:
        line = " ".join(str(error).split())
        raise ToolkitError(f"not valid YAML: {line[:200]}", path=path) from error


def bounded_yaml_loader(text: str, path: Path) -> Any:
    """The loader for a YAML text that has no alias and is nested at most 40 levels deep.

    Raises:
        ToolkitError: an alias, or deeper nesting; names the line.
        yaml.YAMLError: not YAML.
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    depth = 0
    for event in yaml.parse(text, Loader=loader):
        at = f"line {event.start_mark.line + 1}"
        if isinstance(event, yaml.AliasEvent):
            raise ToolkitError(
                "YAML aliases are not read", path=path, field=at, value=f"*{event.anchor}",
                hint="write the value itself",
            )  # fmt: skip
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST_YAML:
            raise ToolkitError(f"nested deeper than {_DEEPEST_YAML} levels", path=path, field=at)
    return loader


def _refuse_twice(node: Any, path: Path) -> None:
    """Refuse mappings with two equal keys, of which YAML would keep the last."""
    import yaml

    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_twice(item, path)
    elif isinstance(node, yaml.MappingNode):
        seen = set()
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise ToolkitError(
                        "a key appears twice",
                        path=path,
                        field=f"line {key.start_mark.line + 1}",
                        value=key.value,
                    )
                seen.add(key.value)
            _refuse_twice(value, path)


def csv_rows(
    lines: Iterable[str], path: Path, *, first: int = 1, delimiter: str = ","
) -> Iterator[list[str]]:
    """The rows of CSV text, one after the other.

    Args:
        lines: of the file.
        path: its name, for errors.
        first: number of the first line.

    Raises:
        ToolkitError: a row that is no CSV, such as one with a field above 131,072 characters.
    """
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            at = f"line {first + reader.line_num - 1}"
            raise ToolkitError(f"not a row of a table: {error}", path=path, field=at) from error
        yield row
