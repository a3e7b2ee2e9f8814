"""One writer per scene at a time, and one annotator."""

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
    with hold_lock(root, "lock", doing="writing to"):
        yield


@contextmanager
def hold_lock(root: Path, name: str, *, doing: str, note: str = "") -> Iterator[None]:
    """Hold one of a scene's locks; a killed holder frees it by dying.

    Args:
        name: of the lock's file in `.std`.
        doing: what the holder does to the scene, for the message to others: "writing to".
        note: more about the holder, for the same message.

    Raises:
        ToolkitError: another process holds it (the message names the owner), or the folder is
            read-only.
    """
    path = root / ".std" / name
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
                f"another process is {doing} this scene: {owner or 'unknown owner'}",
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
        holder = f"{_user()}@{socket.gethostname()} pid {os.getpid()}"
        owner = " ".join(f"{holder}, {note}".split()) if note else holder
        os.pwrite(descriptor, f"{owner}\n".encode(), 0)
        yield
        os.ftruncate(descriptor, 0)
    finally:
        os.close(descriptor)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())
