"""A folder that appears complete or not at all."""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import sync_folder


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A staging folder beside `out`, renamed to `out` when the block ends without an error.

    When the block raises, the staging folder goes, and so do the parents made for it. What a
    killed process left is removed by the next call for the same `out`; a lock on the folder tells
    it from the staging folder of a process that is still at work.

    Raises:
        ToolkitError: there is something at `out` already, or it cannot be written.
    """
    out = out.absolute()
    check_vacant(out)
    made = _make_parents(out.parent)
    try:
        _sweep(out)
        staging = out.with_name(f".{out.name}.{secrets.token_hex(6)}.tmp")
        staging.mkdir()
    except OSError as error:
        _remove_parents(made)
        raise ToolkitError(f"cannot write here: {error.strerror}", path=out.parent) from error
    descriptor = os.open(staging, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield staging
        try:
            staging.rename(out)
        except OSError as error:
            raise ToolkitError(
                f"cannot put the finished folder in place: {error.strerror}", path=out
            ) from error
        sync_folder(out.parent)
    except BaseException as error:
        shutil.rmtree(staging, ignore_errors=True)
        _remove_parents(made)
        if isinstance(error, ToolkitError) and str(staging) in (error.path or ""):
            # The user knows the place that was asked for, not where it was in the making.
            raise error.relocated(staging, out) from error
        raise
    finally:
        os.close(descriptor)


def check_vacant(out: Path) -> None:
    """Refuse an `out` that holds something.

    Raises:
        ToolkitError: a scene, a file or a folder that is not empty is there.
    """
    if (out / "scene.json").exists():
        raise ToolkitError(
            "there is a scene here already", path=out, hint="choose another --out or remove it"
        )
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise ToolkitError("there is a file here already", path=out, hint="choose another --out")
    if out.is_dir() and any(out.iterdir()):
        raise ToolkitError("the folder is not empty", path=out, hint="choose another --out")


def _sweep(out: Path) -> None:
    pattern = re.compile(rf"^\.{re.escape(out.name)}\.[0-9a-f]{{12}}\.tmp$")
    for left in out.parent.iterdir():
        if not (pattern.match(left.name) and left.is_dir() and not left.is_symlink()):
            continue
        descriptor = os.open(left, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(left, ignore_errors=True)
        except BlockingIOError:
            continue  # another import to the same place is at work; the rename decides
        finally:
            os.close(descriptor)


def _make_parents(folder: Path) -> list[Path]:
    missing = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _remove_parents(missing)
        raise ToolkitError(f"cannot make the folder: {error.strerror}", path=folder) from error
    return missing


def _remove_parents(made: list[Path]) -> None:
    for folder in made:
        with suppress(OSError):
            folder.rmdir()
