"""JSON documents: strict, typed, one-line errors that name the field. Digests of content."""

import hashlib
import json
import math
import re
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.regular import read_regular

T = TypeVar("T")

# The largest real document (poses with covariances of 100,000 frames) is below 200 MB.
LARGEST_DOCUMENT_BYTES = 512 * 1024 * 1024

# The largest 64-bit integer has 19 digits.
_MOST_DIGITS = 30

_DIGITS_TO_NINE = bytes.maketrans(b"012345678", b"999999999")

# Raw line breaks occur only between tokens of JSON, so this never matches inside a string.
_NUMBER_LIST = re.compile(r"\[\n\s*((?:-?[\d.eE+-]+,\n\s*)*-?[\d.eE+-]+)\n\s*\]")


DIALECT = "https://json-schema.org/draft/2020-12/schema"


class InvalidDocument(ToolkitError, ValueError):
    """A `ToolkitError` of a document's own checks.

    It is also a ValueError, because msgspec adds the place in the document only to those.
    """


def read_document(path: Path | str, type_: type[T]) -> T:
    """Read and validate a JSON file as `type_` (a msgspec Struct or any type msgspec knows).

    Raises:
        ToolkitError: not found, not JSON, a key given twice, or a field of the wrong type or
            value, named by its path.
    """
    path = Path(path)
    data = read_regular(path, "document", LARGEST_DOCUMENT_BYTES)
    return decode_document(data, type_, path=path)


def decode_document(data: bytes, type_: type[T], *, path: Path | str | None = None) -> T:
    """As `read_document`, of bytes already read."""
    data = data.removeprefix(b"\xef\xbb\xbf")  # a byte order mark
    try:
        document = msgspec.json.decode(data, type=type_)
        if not _is_plainly_strict(data):
            json.loads(data, object_pairs_hook=refuse_twice, parse_int=plain_integer)
    except msgspec.ValidationError as error:
        problem, _, at = str(error).partition(" - at `")
        place = at.strip("`").removeprefix("$").removeprefix(".")
        cause = error.__cause__
        if isinstance(cause, ToolkitError):
            field = ".".join(part for part in (place, cause.field) if part)
            raise ToolkitError(
                cause.problem, path=path, field=field or None, value=cause.value, hint=cause.hint
            ) from error
        raise ToolkitError(problem, path=path, field=place or None) from error
    except ToolkitError as error:
        raise ToolkitError(
            error.problem, path=path, field=error.field, value=error.value, hint=error.hint
        ) from error
    except (ValueError, RecursionError) as error:  # also msgspec.DecodeError, UnicodeDecodeError
        raise ToolkitError(f"not valid JSON: {error}", path=path) from error
    return document


def _is_plainly_strict(data: bytes) -> bool:
    """Whether valid JSON has no key twice and no long integer, as far as a quick look tells.

    A key that appears twice is lost with its quotes on the way through a dictionary. Only an
    escape by number could make up for them.
    """
    if b"\\u" in data or b"9" * (_MOST_DIGITS + 1) in data.translate(_DIGITS_TO_NINE):
        return False
    return data.count(b'"') == msgspec.json.encode(msgspec.json.decode(data)).count(b'"')


def document_bytes(document: Any, *, path: Path | str | None = None) -> bytes:
    """Deterministic, human-readable JSON of a document: indented, long number lists on one line.

    Raises:
        ToolkitError: a number is not finite (JSON has no NaN; it would silently become null), a
            value has a type that JSON lacks, or the document would not pass its own validation.
    """
    _refuse_not_finite(msgspec.to_builtins(document, enc_hook=plain_number), path, "")
    try:
        encoded = msgspec.json.encode(document, enc_hook=plain_number)
    except UnicodeEncodeError as error:  # of a file name or word in another encoding
        raise ToolkitError(
            "cannot be written as JSON: not text", path=path, value=error.object[:80]
        ) from error
    if isinstance(document, msgspec.Struct):
        # Structs are not checked when they are made; what is written must be readable.
        decode_document(encoded, type(document), path=path)
    text = msgspec.json.format(encoded, indent=2).decode()
    return (_join_number_lists(text) + "\n").encode()


def write_document(path: Path | str, document: Any) -> None:
    """Write a document atomically as JSON; errors as in `document_bytes`."""
    write_bytes_atomic(path, document_bytes(document, path=path))


def digest_file(path: Path) -> str:
    """Return the hex digest of the content of a file.

    Raises:
        ToolkitError: it is not a regular file (a pipe or device could block or never end).
    """
    if not path.is_file():
        problem = "is not a regular file" if path.exists() else "file not found"
        raise ToolkitError(problem, path=path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def digest_bytes(data: bytes) -> str:
    """Return the hex digest of content in memory: that of a file of it."""
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def digest_files(root: Path, paths: Iterable[Path]) -> dict[str, str]:
    """Return the digest of each file by its path relative to `root`; "" if there is no file."""
    return {
        path.relative_to(root).as_posix(): digest_file(path) if path.is_file() else ""
        for path in paths
    }


def utc_text(
    moment: datetime | None = None, *, timespec: Literal["seconds", "milliseconds"] = "seconds"
) -> str:
    """A time as documents hold it: UTC, ISO 8601, `Z` at its end; now without a moment.

    >>> utc_text(datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC))
    '2026-01-02T03:04:05Z'
    """
    moment = datetime.now(UTC) if moment is None else moment.astimezone(UTC)
    return moment.isoformat(timespec=timespec).replace("+00:00", "Z")


def digest_of(*parts: Any, versioned: bool = True) -> str:
    """Return the hex digest of plain values and documents.

    Numbers must be finite: JSON encodes NaN as null, so different inputs would have one digest.

    Args:
        parts: the values.
        versioned: include the version of the toolkit.
    """
    tool = [__version__] if versioned else []
    encoded = msgspec.json.encode([tool, *parts], order="sorted")
    return hashlib.blake2b(encoded, digest_size=16).hexdigest()


def _join_number_lists(text: str) -> str:
    """Put lists of plain numbers on one line, so that a pose does not take 16 lines."""
    return _NUMBER_LIST.sub(lambda m: "[" + " ".join(m.group(1).split()) + "]", text)


def refuse_twice(pairs: list[tuple[str, Any]]) -> None:
    """Check that no key is given twice; the `object_pairs_hook` of json.

    Raises:
        ToolkitError: a key appears twice in one object.
    """
    keys = [key for key, _ in pairs]
    if len(set(keys)) != len(keys):
        key = next(k for i, k in enumerate(keys) if k in keys[:i])
        raise ToolkitError("a key appears twice in one object", field=key[:80])


def plain_integer(digits: str) -> int:
    """The `parse_int` of json.

    Raises:
        ToolkitError: more digits than any reader keeps.
    """
    if len(digits) > _MOST_DIGITS:
        raise ToolkitError(
            "an integer is implausibly long", value=f"{digits[:20]}... ({len(digits)} digits)"
        )
    return int(digits)


def plain_number(value: Any) -> Any:
    """The `enc_hook` of msgspec: converts NumPy numbers, rejects other types."""
    if getattr(value, "shape", None) == ():  # a number of numpy
        return value.item()
    raise ToolkitError(
        f"cannot be written as JSON: {type(value).__name__}", value=value, hint="use plain numbers"
    )


def _refuse_not_finite(value: Any, path: Path | str | None, field: str) -> None:
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ToolkitError("is not finite", path=path, field=field.lstrip("."), value=value)
    elif isinstance(value, dict):
        for key, item in value.items():
            _refuse_not_finite(item, path, f"{field}.{key}")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _refuse_not_finite(item, path, f"{field}[{index}]")
