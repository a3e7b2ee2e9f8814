"""Text files of other programs, with or without a byte order mark."""

import stat
from pathlib import Path

from std_toolkit.errors import ToolkitError

_MARKS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


def read_text(path: Path, *, what: str, largest_bytes: int) -> str:
    """The text of a file in UTF-8, or in UTF-16 with a byte order mark; the mark is left out.

    Editors and shells of Windows write such marks, and UTF-16 where output is redirected.

    Args:
        path: the file.
        what: what the file is, for errors: "intrinsics file".
        largest_bytes: a larger file is refused.

    Raises:
        ToolkitError: not found, no regular file, too large, or not text.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ToolkitError(f"the {what} is not a regular file", path=path)
        if status.st_size > largest_bytes:
            raise ToolkitError(f"the {what} is implausibly large", path=path)
        data = path.read_bytes()
    except OSError as error:
        raise ToolkitError(f"cannot read the {what}: {error.strerror}", path=path) from error
    return decode_text(data, path, what=what)


def decode_text(data: bytes, path: Path, *, what: str) -> str:
    """The same of bytes already read."""
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise ToolkitError(f"the {what} is not text", path=path) from error
