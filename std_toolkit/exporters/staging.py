"""The staging area of an export, which is kept if a run is interrupted.

The export is written to `.NAME.partial` and renamed to `NAME` when it is complete. A killed run
leaves `.NAME.partial`, and the next run of the same export resumes there. A lock distinguishes an
active staging area from an abandoned one.
"""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.exporter import FrameRow
from std_toolkit.io.atomic import refuse_links, sweep_temporaries
from std_toolkit.io.documents import digest_files, read_document
from std_toolkit.jobs.artefact import Record, changed_files
from std_toolkit.scene.sidecar import SIDECAR_NAME, Sidecar

PROGRESS = ".progress"


class Progress(Record, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A finished frame in the staging area."""

    row: FrameRow


def state_of(out: Path, digest: str) -> Literal["vacant", "same", "other"]:
    """Content of `out`: nothing, this export complete, or something else."""
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return "vacant"
    path = out / SIDECAR_NAME
    if not out.is_dir() or not path.is_file():
        return "other"
    try:
        sidecar = read_document(path, Sidecar)
    except ToolkitError:
        return "other"
    same = sidecar.digest == digest and not changed_files(out, sidecar.files)
    return "same" if same else "other"


@contextmanager
def staging_area(out: Path, *, overwrite: bool, mark: str = SIDECAR_NAME) -> Iterator[Path]:
    """The staging folder, moved to `out` when the block ends without an error.

    If the block raises after a frame was written, the folder is kept and the next run resumes. What
    lies in its folder `PROGRESS` is not moved.

    Args:
        out: the finished folder.
        overwrite: whether an earlier export may be replaced.
        mark: file by which one is known.

    Raises:
        ToolkitError: `out` has other content, or another process exports to it.
    """
    out = out.absolute()
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise ToolkitError("a file already exists here", path=out, hint="choose another --out")
    if out.is_dir() and any(out.iterdir()) and not overwrite:
        raise ToolkitError(
            "the folder is not empty and is not a complete export of this scene",
            path=out,
            hint="choose another --out, or give --overwrite to replace an earlier export",
        )
    if overwrite and out.is_dir() and any(out.iterdir()) and not (out / mark).is_file():
        raise ToolkitError(
            "this is not an export; --overwrite replaces only exports",
            path=out,
            hint="choose another --out",
        )
    staging = out.with_name(f".{out.name}.partial")
    if staging.is_symlink():
        raise ToolkitError("the staging folder must not be a symbolic link", path=staging)
    try:
        staging.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ToolkitError(f"cannot write here: {error.strerror}", path=out.parent) from error
    descriptor = os.open(staging, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ToolkitError("another process is exporting to this folder", path=out) from error
        refuse_links(staging)
        sweep_temporaries(staging)
        try:
            yield staging
        except BaseException:
            if not any((staging / PROGRESS).rglob("*.json")):
                # Nothing in it would be resumed.
                shutil.rmtree(staging, ignore_errors=True)
            raise
        _put_in_place(staging, out)
    finally:
        os.close(descriptor)


def progress_path(staging: Path, frame_id: int) -> Path:
    """Path of the record of a frame in the staging area."""
    return staging / PROGRESS / f"{frame_id:06d}.json"


def drop_strangers(staging: Path, expected: set[str]) -> None:
    """Remove files of an earlier run with other inputs, and empty folders."""
    for path in sorted(staging.rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink():
            if not any(path.iterdir()):
                path.rmdir()
        elif path.relative_to(staging).as_posix() not in expected:
            path.unlink()


def file_digests(staging: Path) -> dict[str, str]:
    """Digest of every file in the staging area except its records, by relative path."""
    files = digest_files(staging, sorted(p for p in staging.rglob("*") if p.is_file()))
    own = (f"{PROGRESS}/", SIDECAR_NAME)
    return {name: digest for name, digest in files.items() if not name.startswith(own)}


def _put_in_place(staging: Path, out: Path) -> None:
    shutil.rmtree(staging / PROGRESS, ignore_errors=True)
    old = out.with_name(f".{out.name}.replaced")
    # Also the remains of a run that was killed between the two moves below.
    shutil.rmtree(old, ignore_errors=True)
    if out.is_dir() and any(out.iterdir()):
        out.rename(old)
    staging.rename(out)
    shutil.rmtree(old, ignore_errors=True)
    descriptor = os.open(out.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
