"""Atomic writes: a file is either the old one or the complete new one, whenever the power goes."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from std_toolkit.errors import ToolkitError

_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{12}\.tmp(\.[A-Za-z0-9]+)?")
# Leaves room for the random part in file systems that allow 255 bytes.
_LONGEST_STEM = 100


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """A temporary path beside `path`, moved to `path` when the block ends without an error.

    The temporary keeps the suffix, for libraries that choose the format by it. It is synced to
    disk before the move and removed when the block raises. A symbolic link at `path` is
    replaced, never written through.

    Raises:
        ToolkitError: the file cannot be written; the message names `path` and the reason.
    """
    path = Path(path)
    temporary = path.with_name(
        f".{path.stem[:_LONGEST_STEM]}.{secrets.token_hex(6)}.tmp{path.suffix}"
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        _remove(temporary)
        if error.filename not in (None, str(temporary), str(path), str(path.parent)):
            raise  # the block failed at another file
        # Without a name (disk full) or with the temporary's the message would help nobody.
        raise ToolkitError(
            f"cannot write the file: {error.strerror or error}", path=path
        ) from error
    except BaseException:
        _remove(temporary)
        raise


def write_bytes_atomic(path: Path | str, data: bytes | memoryview) -> None:
    """Write `data` to `path` atomically; errors as in `atomic_path`."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def sweep_temporaries(folder: Path | str) -> list[Path]:
    """Remove what killed writers left below `folder`; call it while holding the scene's lock.

    Returns:
        The removed files.
    """
    left = [
        path
        for path in Path(folder).rglob(".*.tmp*")
        if _TEMPORARY.fullmatch(path.name) and (path.is_symlink() or path.is_file())
    ]
    for path in left:
        path.unlink(missing_ok=True)
    return left


def _remove(temporary: Path) -> None:
    # A failure here (the folder is a file, the disk went away) must not hide the first one.
    with suppress(OSError):
        temporary.unlink()


def sync_folder(folder: Path) -> None:
    """Have a folder's entries on disk: a new or renamed file is durable only then."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
