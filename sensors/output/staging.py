"""Folders of a data set that appear complete or not at all.

Readers of the public layouts glob for files two levels below a split. They would read an unfinished
folder beside the finished ones, whatever its name. It is therefore written below `.partial` at the
top of the data set and moved into place when it is complete.
"""

import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import remove_unfinished, sync_folder

WAITING = ".partial"
_ATTEMPTS = 100


@contextmanager
def staged_folder(top: Path, relative: str) -> Iterator[Path]:
    """A folder that becomes `top / relative` when the block ends without an error.

    If the block raises, the folder is removed. The next call for the same folder removes what a
    killed process left; a lock distinguishes it from the folder of a running process.

    Args:
        top: of the data set; on one file system.
        relative: final path of the folder.

    Raises:
        ToolkitError: the path exists, or it cannot be written.
    """
    target = top / relative
    refuse_existing(target)
    waiting = top / WAITING
    name = relative.replace("/", "+")
    try:
        remove_unfinished(waiting, rf"{re.escape(name)}\.[0-9a-f]{{12}}")
        staging, descriptor = _make(waiting, name)
    except OSError as error:
        raise ToolkitError(f"cannot write here: {error.strerror}", path=top) from error
    try:
        yield staging
        sync_folder(staging)
        refuse_existing(target)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            staging.rename(target)
            sync_folder(target.parent)
        except OSError as error:
            raise ToolkitError(
                f"cannot put the finished folder in place: {error.strerror}", path=target
            ) from error
    except BaseException as error:
        shutil.rmtree(staging, ignore_errors=True)
        if isinstance(error, ToolkitError) and str(staging) in (error.path or ""):
            # The message names the path that the user gave, not the temporary one.
            raise error.relocated(staging, target) from error
        raise
    finally:
        os.close(descriptor)
        with suppress(OSError):
            waiting.rmdir()  # fails while other processes use it


def refuse_existing(target: Path) -> None:
    """Raise ToolkitError if `target` exists."""
    if target.is_symlink() or target.exists():
        raise ToolkitError("there is something here already", path=target)


def _make(waiting: Path, name: str) -> tuple[Path, int]:
    for _ in range(_ATTEMPTS):
        staging = waiting / f"{name}.{secrets.token_hex(6)}"
        try:
            waiting.mkdir(parents=True, exist_ok=True)
            staging.mkdir()
            descriptor = os.open(staging, os.O_RDONLY)
        except (FileNotFoundError, FileExistsError):
            continue  # another process removed the empty parent folder
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            continue  # removed by another process between the two calls above
        if staging.exists():
            return staging, descriptor
        os.close(descriptor)
    raise ToolkitError("cannot make a folder to work in", path=waiting)
