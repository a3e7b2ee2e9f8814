"""JSON documents: strict, typed, one-line errors that name the field."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

T = TypeVar("T")
# The largest real document (poses with covariances of 100,000 frames) is below 200 MB.
LARGEST_DOCUMENT_BYTES = 512 * 1024 * 1024


def read_document(path: Path | str, type_: type[T]) -> T:
    """Read and validate a JSON file as `type_` (a msgspec Struct or any type msgspec knows).

    Raises:
        ToolkitError: not found, not JSON, or a field of the wrong type, named by its path.
    """
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_DOCUMENT_BYTES:
            raise ToolkitError("the document is implausibly large", path=path)
        data = path.read_bytes()
    except OSError as error:
        raise ToolkitError(f"cannot read the document: {error.strerror}", path=path) from error
    try:
        return msgspec.json.decode(data, type=type_)
    except msgspec.ValidationError as error:
        problem, _, at = str(error).partition(" - at `$")
        raise ToolkitError(problem, path=path, field=at.strip("`.") or None) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ToolkitError(f"not valid JSON: {error}", path=path) from error
    except ToolkitError as error:
        raise ToolkitError(
            error.problem, path=path, field=error.field, value=error.value, hint=error.hint
        ) from error


def document_bytes(document: Any) -> bytes:
    """Deterministic, human-readable JSON of a document: indented, long number lists on one line."""
    text = msgspec.json.format(msgspec.json.encode(document), indent=2).decode()
    return (_join_number_lists(text) + "\n").encode()


def write_document(path: Path | str, document: Any) -> None:
    """Write a document atomically as JSON."""
    write_bytes_atomic(path, document_bytes(document))


def _join_number_lists(text: str) -> str:
    """Put lists of plain numbers on one line: a pose as 16 lines cannot be read."""
    import re

    return re.sub(
        r"\[\s+((?:-?[\d.eE+-]+,\s+)*-?[\d.eE+-]+)\s+\]",
        lambda m: "[" + ", ".join(part.strip() for part in m.group(1).split(",")) + "]",
        text,
    )
