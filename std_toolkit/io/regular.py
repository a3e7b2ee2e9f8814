"""Opening files of others: regular ones only, at once, and no larger than they may be."""

import os
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

from std_toolkit.errors import ToolkitError

MIB = 2**20

_MARKS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


def open_regular_file(path: Path, kind: str, largest_bytes: int) -> BinaryIO:
    """Open a regular file for reading.

    A pipe or device could block or never end; it is refused at once.

    Args:
        kind: what it is, for the error: "JSON file".
        largest_bytes: what no real file of this kind is above.

    Raises:
        ToolkitError: not found, not a regular file, not readable or implausibly large.
    """
    try:
        # Without O_NONBLOCK, opening a pipe waits for its writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ToolkitError(f"cannot read the {kind}: {reason}", path=path) from error
    status = os.fstat(descriptor)
    problem = ""
    if not stat.S_ISREG(status.st_mode):
        problem = "is not a regular file"
    elif status.st_size > largest_bytes:
        problem = f"the {kind} is implausibly large: {status.st_size / MIB:.0f} MB"
    if problem:
        os.close(descriptor)
        raise ToolkitError(problem, path=path)
    return os.fdopen(descriptor, "rb")


def read_regular(path: Path, kind: str, largest_bytes: int = 64 * MIB) -> bytes:
    """The bytes of a regular file; errors as in `open_regular_file`."""
    with open_regular_file(path, kind, largest_bytes) as file:
        try:
            return file.read()
        except OSError as error:
            raise ToolkitError(f"cannot read the {kind}: {error.strerror}", path=path) from error


def read_text(path: Path, kind: str, largest_bytes: int = 64 * MIB) -> str:
    """The text of a regular file in UTF-8, or in UTF-16 with a byte order mark, which is left out.

    Editors and shells of Windows write such marks, and UTF-16 where output is redirected.

    Raises:
        ToolkitError: as `read_regular`, or it is not text.
    """
    data = read_regular(path, kind, largest_bytes)
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise ToolkitError(f"the {kind} is not text: {error}", path=path) from error


def file_sizes(root: Path, names: Iterable[str]) -> list[int]:
    """The size in bytes of each file of a folder; -1 where there is none. For thousands of files.

    Args:
        root: the folder.
        names: paths relative to it.
    """
    sizes, folder = [], f"{root}/"
    for name in names:
        try:
            found = os.stat(folder + name)  # noqa: PTH116 - five times as fast as a Path
            sizes.append(found.st_size if stat.S_ISREG(found.st_mode) else -1)
        except (OSError, ValueError):
            sizes.append(-1)
    return sizes
