"""Locks of folders that several processes write to; they end with the process that holds them.

A scene has one writer and one annotator at a time. The lock of an annotator has a heartbeat: on a
drive that several computers share, the lock of one that lost its power or its network can stay, and
some such drives do not share locks at all.
"""

from __future__ import annotations

import fcntl
import getpass
import os
import socket
import tempfile
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import refuse_links
from std_toolkit.log import logger

_MOMENT_S = 0.02

# A heartbeat is a new time of the lock file. Nine in a row are missed only by a computer that is
# off, asleep or without network.
BEAT_S, DEAD_S = 20.0, 180.0
TAKE_OVER = "take it over"


@dataclass
class Held:
    """A lock that is held.

    Attributes:
        path: of its file.
        descriptor: of the file as it was locked.
    """

    path: Path
    descriptor: int
    _end: threading.Event = field(default_factory=threading.Event)

    def check(self) -> None:
        """Check that nobody took the lock over, as after this computer slept.

        Raises:
            ToolkitError: somebody did, or the file is gone.
        """
        try:
            now, own = self.path.stat(), os.fstat(self.descriptor)
        except OSError:
            return  # the drive is away for a moment; writing to it will tell
        if (now.st_dev, now.st_ino) != (own.st_dev, own.st_ino):
            holder = ""
            with suppress(OSError):
                holder = person_of(self.path.read_text(errors="replace").strip())
            raise ToolkitError(
                f"{holder or 'somebody'} took this scene over: this computer was not heard of for "
                "minutes",
                path=self.path.parent.parent,
                hint="open it again; the edits until then are in its journal",
            )

    def beat_until_released(self) -> None:
        """Renew the time of the file now and then, in a thread of its own."""

        def beat() -> None:
            while not self._end.wait(BEAT_S):
                with suppress(OSError):
                    os.utime(self.descriptor)

        threading.Thread(target=beat, name="heartbeat of a lock", daemon=True).start()

    def release(self) -> None:
        """End the heartbeat."""
        self._end.set()


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
    beats: bool = False,
    take_over: bool = False,
) -> Iterator[Held]:
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
        beats: whether the lock has a heartbeat.
        take_over: take a lock whose holder, on another computer, has no heartbeat any more.

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
            owner = _owner(descriptor) if beats else ""
            if owner and _is_elsewhere(owner) and _silence(path) < DEAD_S:
                # The drive does not share locks, or the holder crashed a moment ago.
                raise _refused(root, owner, doing, what)
        except BlockingIOError as error:
            owner = _owner(descriptor) or "unknown owner"
            dead = beats and _is_elsewhere(owner) and (silence := _silence(path)) > DEAD_S
            if dead and take_over:
                logger.warning("%s: took over the lock of %s", root, owner)
                old, descriptor = descriptor, _replaced(path)
                os.close(old)
            elif wait:
                logger.info("%s: waiting for another process: %s", root, owner)
                fcntl.flock(descriptor, fcntl.LOCK_EX)
            else:
                refused = _refused(root, owner, doing, what)
                if dead:
                    refused = refused.revised(
                        hint=f"its computer was not heard of for {silence / 60:.0f} minutes; if it "
                        f"is off, {TAKE_OVER} (--take-over)"
                    )
                raise refused from error
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
        held = Held(path, descriptor)
        if beats:
            held.beat_until_released()
        try:
            yield held
        finally:
            held.release()
        os.ftruncate(descriptor, 0)
    finally:
        os.close(descriptor)


def _refused(root: Path, owner: str, doing: str, what: str) -> ToolkitError:
    return ToolkitError(
        f"another process is {doing} this {what}: {owner}",
        path=root,
        hint="wait for it or end it",
    )


def _owner(descriptor: int) -> str:
    return os.pread(descriptor, 400, 0).decode(errors="replace").strip()


def _is_elsewhere(owner: str) -> bool:
    """Whether a holder is on another computer; of this one, the lock itself tells all."""
    computer = owner.partition(" pid ")[0].partition("@")[2]
    return bool(computer) and computer != socket.gethostname()


def _silence(path: Path) -> float:
    """Seconds since the last heartbeat, by the clock of the drive."""
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", suffix=".tmp") as probe:
        now = os.fstat(probe.fileno()).st_mtime
    return now - path.stat().st_mtime


def _replaced(path: Path) -> int:
    """Put a new, locked file in place of a lock whose holder is gone; returns its descriptor."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".tmp")
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.fchmod(descriptor, path.stat().st_mode & 0o777)
    Path(name).replace(path)
    return descriptor


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
        # On a drive that does not share locks, only the heartbeat tells.
        owner = _owner(descriptor)
        beats = owner and time.time() - os.fstat(descriptor).st_mtime < DEAD_S
        return owner if beats and _is_elsewhere(owner) else ""
    except BlockingIOError:
        return _owner(descriptor) or "unknown owner"
    except OSError:
        return ""
    finally:
        os.close(descriptor)


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
