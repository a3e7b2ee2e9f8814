"""Locks of folders that several processes write to; they end with the process that holds them.

A scene has one writer and one annotator at a time.
"""

from __future__ import annotations

import fcntl
import getpass
import os
import socket
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import refuse_links
from std_toolkit.log import logger

_MOMENT_S = 0.02


@contextmanager
def scene_lock(root: Path, *, images: bool = False) -> Iterator[None]:
    """Hold the write lock of a scene; it is released when its process ends.

    Args:
        images: whether images are written, too; their folders must then be no links, either.

    Raises:
        ToolkitError: another process holds it (the message names the owner), or the folder is
            read-only.
    """
    with hold_lock(root, "lock", doing="writing to", images=images):
        yield


@contextmanager
def hold_lock(
    root: Path,
    name: str,
    *,
    doing: str,
    note: str = "",
    wait: bool = False,
    what: str = "scene",
    deep: bool = True,
    images: bool = False,
    inputs: Collection[str] = (),
) -> Iterator[None]:
    """Hold one of the locks of a scene; it is released when its process ends.

    Args:
        name: name of the lock file in `.std`.
        doing: what the holder does to the scene, for the error message: "writing to".
        what: word for the folder in the error message, where it is no scene.
        note: more about the holder, for the same message.
        wait: wait until another process releases it, and log whom it waits for.
        deep: whether folders below `root` are written to, so that none may be a link out of it.
        images: whether the images of a scene are written to, too.
        inputs: see `refuse_links`.

    Raises:
        ToolkitError: another process holds it (the message names the owner), or the folder is
            read-only.
    """
    path = root / ".std" / name
    refuse_links(root if deep else path.parent, home=root, images=images, inputs=inputs)
    try:
        path.parent.mkdir(exist_ok=True)
        # The owner's name is written into the file: never follow a link to another file.
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise ToolkitError(f"cannot write to the {what}: {error.strerror}", path=root) from error
    try:
        try:
            _lock(descriptor)
        except BlockingIOError as error:
            owner = os.pread(descriptor, 200, 0).decode(errors="replace").strip()
            owner = owner or "unknown owner"
            if not wait:
                raise ToolkitError(
                    f"another process is {doing} this {what}: {owner}",
                    path=root,
                    hint="wait for it or end it",
                ) from error
            logger.info("%s: waiting for another process: %s", root, owner)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
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


def _lock(descriptor: int) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        # `lock_holder` of another process holds it for a moment.
        time.sleep(_MOMENT_S)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def lock_holder(root: Path, name: str) -> str:
    """Who holds a lock of a scene now, as `hold_lock` wrote it; "" if nobody does."""
    try:
        descriptor = os.open(root / ".std" / name, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return ""
    try:
        # What a killed process wrote stays in the file, but its lock does not.
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return os.pread(descriptor, 200, 0).decode(errors="replace").strip() or "unknown owner"
    except OSError:
        return ""
    finally:
        os.close(descriptor)
    return ""


def person_of(holder: str) -> str:
    """The person and the computer of what `lock_holder` says; "" for nobody.

    >>> person_of("root@lab2 pid 12, annotator Ann B.")
    'Ann B. (lab2)'
    >>> person_of("root@lab2 pid 12")
    'root (lab2)'
    """
    account, _, note = holder.partition(", annotator ")
    user, _, computer = account.partition(" pid ")[0].partition("@")
    return f"{note or user} ({computer})" if computer else holder


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())
