"""One writer per scene at a time."""

from __future__ import annotations

import fcntl
import getpass
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from std_toolkit.errors import ToolkitError


@contextmanager
def scene_lock(root: Path) -> Iterator[None]:
    """Hold the scene's write lock; a killed holder frees it by dying.

    Raises:
        ToolkitError: another process holds it (the message names the owner), or the folder is
            read-only.
    """
    path = root / ".std" / "lock"
    if path.parent.is_symlink():
        raise ToolkitError("the scene's .std folder must not be a symbolic link", path=root)
    try:
        path.parent.mkdir(exist_ok=True)
        # The owner's name is written into the file: never through a link to another file.
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise ToolkitError(f"cannot write to the scene: {error.strerror}", path=root) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.pread(descriptor, 200, 0).decode(errors="replace").strip()
            raise ToolkitError(
                f"another process is writing to this scene: {owner or 'unknown owner'}",
                path=root,
                hint="wait for it or end it",
            ) from error
        except OSError as error:
            raise ToolkitError(
                f"cannot lock the scene: {error.strerror}",
                path=root,
                hint="its file system must support locks (flock)",
            ) from error
        os.ftruncate(descriptor, 0)
        owner = f"{_user()}@{socket.gethostname()} pid {os.getpid()}\n"
        os.pwrite(descriptor, owner.encode(), 0)
        yield
        os.ftruncate(descriptor, 0)
    finally:
        os.close(descriptor)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())
