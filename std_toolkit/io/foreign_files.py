"""Reading arrays, JSON, YAML and CSV files of other programs, whatever they hold.

The readers of NumPy, PyYAML and csv trust their input: a header of a few bytes can ask for a
terabyte, aliases of YAML grow exponentially, and a long field raises an error without a file name.
"""

import csv
import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import refuse_twice

# Real YAML files of poses and cameras are below 100 kB and 10 levels.
_LARGEST_YAML_BYTES = 1024 * 1024
_DEEPEST_YAML = 40
_LARGEST_JSON_BYTES = 16 * 1024 * 1024
# The largest 64-bit integer has 19 digits.
_MOST_DIGITS = 30


def read_npy(path: Path) -> NDArray[Any]:
    """A .npy file with an array of numbers.

    Raises:
        ToolkitError: not found, not such a file, or not the number of bytes that its header says.
    """
    try:
        with path.open("rb") as file:
            _check_npy(file, path)
            file.seek(0)
            return np.asarray(np.load(file, allow_pickle=False))
    except FileNotFoundError as error:
        raise ToolkitError("file not found", path=path) from error
    except (ValueError, OSError, EOFError, TypeError, SyntaxError, RecursionError) as error:
        raise ToolkitError(f"not a numpy array of numbers: {error}", path=path) from error


def _check_npy(file: BinaryIO, path: Path) -> None:
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    if dtype.kind not in "biuf":
        raise ToolkitError("not a numpy array of numbers", path=path, value=str(dtype))
    # Python's integers: the product of the sizes may be larger than 64 bits.
    needed = math.prod(int(n) for n in shape) * dtype.itemsize
    held = path.stat().st_size - file.tell()
    if needed != held:
        raise ToolkitError(
            f"the file is damaged: its header needs {needed} bytes of numbers, it holds {held}",
            path=path,
            value="x".join(map(str, shape)) or "one number",
        )


def read_json(path: Path, *, largest_bytes: int = _LARGEST_JSON_BYTES) -> Any:
    """A JSON file of plain values.

    Raises:
        ToolkitError: unreadable, larger than `largest_bytes`, not JSON, nested too deeply, a key
            given twice, or a number of more digits than any reader keeps.
    """
    try:
        if path.stat().st_size > largest_bytes:
            raise ToolkitError("the JSON file is implausibly large", path=path)
        text = path.read_text(encoding="utf-8-sig")
        return json.loads(text, object_pairs_hook=_unique_keys, parse_int=_plain_integer)
    except OSError as error:
        raise ToolkitError(f"cannot read the file: {error.strerror}", path=path) from error
    except ToolkitError as error:
        raise ToolkitError(
            error.problem, path=path, field=error.field, value=error.value
        ) from error
    except RecursionError as error:
        raise ToolkitError("not valid JSON: nested too deeply", path=path) from error
    except ValueError as error:  # also UnicodeDecodeError
        raise ToolkitError(f"not valid JSON: {str(error)[:200]}", path=path) from error


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    refuse_twice(pairs)
    return dict(pairs)


def _plain_integer(digits: str) -> int:
    if len(digits) > _MOST_DIGITS:
        raise ToolkitError(
            "an integer is implausibly long", value=f"{digits[:20]}... ({len(digits)} digits)"
        )
    return int(digits)


def read_yaml(path: Path) -> Any:
    """A YAML file of plain values.

    Raises:
        ToolkitError: unreadable, not YAML, a key given twice, larger than 1 MB, nested deeper than
            40 levels, or with aliases.
    """
    import yaml  # type: ignore[import-untyped]

    try:
        if path.stat().st_size > _LARGEST_YAML_BYTES:
            raise ToolkitError("the YAML file is implausibly large", path=path)
        text = path.read_text(encoding="utf-8-sig")
        depth = 0
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        for event in yaml.parse(text, Loader=loader):
            if isinstance(event, yaml.AliasEvent):
                raise ToolkitError(
                    "YAML aliases are not read",
                    path=path,
                    field=f"line {event.start_mark.line + 1}",
                    value=f"*{event.anchor}",
                    hint="write the value itself",
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST_YAML:
                raise ToolkitError(
                    f"nested deeper than {_DEEPEST_YAML} levels",
                    path=path,
                    field=f"line {event.start_mark.line + 1}",
                )
        node = yaml.compose(text, Loader=loader)
        if node is not None:
            _refuse_twice(node, path)
        return yaml.load(text, Loader=loader)
    except OSError as error:
        raise ToolkitError(f"cannot read the file: {error.strerror}", path=path) from error
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        line = " ".join(str(error).split())
        raise ToolkitError(f"not valid YAML: {line[:200]}", path=path) from error


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
