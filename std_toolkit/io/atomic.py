"""Atomic writes of files and folders: a file or folder is either the old one or complete."""

import csv
import fcntl
import io
import os
import re
import secrets
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from std_toolkit.errors import ToolkitError

_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{12}\.tmp(\.[A-Za-z0-9]+)?")

# Folders of a scene that are only read; their images may be links.
_INPUT_FOLDERS = ("color", "depth", "masks", "infrared", "reference")

# Leaves room for the random part in file systems that allow 255 bytes.
_LONGEST_STEM = 100


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """A temporary path beside `path`, moved to `path` when the block ends without an error.

    The temporary file keeps the suffix, because libraries select the format by it. It is synced
    to disk before the move and removed when the block raises. A symbolic link at `path` is
    replaced, never followed.

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
        # Without a name (disk full), or with that of the temporary, the message is no help.
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


def write_csv_atomic(
    path: Path | str, columns: Sequence[str], rows: Iterable[Mapping[str, object]]
) -> None:
    """Write a table with a head, atomically; what a row does not have is empty.

    Errors as in `atomic_path`.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    write_bytes_atomic(path, text.getvalue().encode())


def sweep_temporaries(folder: Path | str) -> list[Path]:
    """Remove temporary files of killed writers in `folder`; call it while holding the scene lock.

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
    """Sync a folder to disk, which makes new and renamed files in it durable."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A staging folder beside `out`, renamed to `out` when the block ends without an error.

    When the block raises, the staging folder and the parents created for it are removed. The
    staging folder of a killed process is removed by the next call for the same `out`; a lock
    distinguishes it from that of a running process.

    Raises:
        ToolkitError: `out` has content, or it cannot be written.
    """
    out = out.absolute()
    check_vacant(out)
    staging, descriptor, made = _beside(out)
    try:
        yield staging
        try:
            staging.rename(out)
        except OSError as error:
            raise ToolkitError(
                f"cannot move the finished folder here: {error.strerror}", path=out
            ) from error
        sync_folder(out.parent)
    except BaseException as error:
        shutil.rmtree(staging, ignore_errors=True)
        _remove_parents(made)
        if isinstance(error, ToolkitError) and str(staging) in (error.path or ""):
            # The user knows the requested path, not that of the staging folder.
            raise error.relocated(staging, out) from error
        raise
    finally:
        os.close(descriptor)


@contextmanager
def temporary_folder(out: Path) -> Iterator[Path]:
    """A folder beside `out` for intermediate files, removed when the block ends.

    What a killed process left is removed by the next folder beside the same `out`.

    Raises:
        ToolkitError: it cannot be written.
    """
    out = out.absolute()
    folder, descriptor, made = _beside(out)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(descriptor)
        if not out.exists():
            _remove_parents(made)


def check_vacant(out: Path) -> None:
    """Check that `out` does not exist or is an empty folder.

    Raises:
        ToolkitError: it is a scene, a file or a folder that is not empty.
    """
    if (out / "scene.json").exists():
        raise ToolkitError(
            "a scene already exists here", path=out, hint="choose another --out or remove it"
        )
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise ToolkitError("a file already exists here", path=out, hint="choose another --out")
    if out.is_dir() and any(out.iterdir()):
        raise ToolkitError("the folder is not empty", path=out, hint="choose another --out")


def _beside(out: Path) -> tuple[Path, int, list[Path]]:
    """A locked folder beside `out`, the descriptor of its lock, and the parents made for it."""
    made = _make_parents(out.parent)
    try:
        remove_unfinished(out.parent, rf"\.{re.escape(out.name)}\.[0-9a-f]{{12}}\.tmp")
        folder = out.with_name(f".{out.name}.{secrets.token_hex(6)}.tmp")
        folder.mkdir()
    except OSError as error:
        _remove_parents(made)
        raise ToolkitError(f"cannot write here: {error.strerror}", path=out.parent) from error
    descriptor = os.open(folder, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return folder, descriptor, made


def remove_unfinished(parent: Path, pattern: str) -> None:
    """Remove the folders of killed processes; those of running ones are locked and stay.

    Args:
        parent: folder that contains them; nothing happens if it does not exist.
        pattern: regular expression of their names.
    """
    try:
        found = list(parent.iterdir())
    except FileNotFoundError:  # also removed by another process
        return
    for left in found:
        if not (re.fullmatch(pattern, left.name) and left.is_dir() and not left.is_symlink()):
            continue
        with suppress(FileNotFoundError):
            descriptor = os.open(left, os.O_RDONLY)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(left, ignore_errors=True)
            except BlockingIOError:
                continue  # another process writes the same folder; the rename decides
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


def refuse_links(
    root: Path,
    *,
    home: Path | None = None,
    depth: int | None = None,
    images: bool = False,
    inputs: Collection[str] = (),
) -> None:
    """Check that no folder that programs write to leads out of `root`.

    A scene or a folder of results from somebody else could have a link to any folder of the reader,
    and a step would write there. Links to files are replaced, never followed. Images of a scene,
    and the folders that hold them, may be links.

    Args:
        root: folder that is written to; itself it may be a link.
        home: folder that links may lead into, above or at `root` (default: `root`); then `root`
            itself must not lead out of it.
        depth: levels of folders that are looked at (default: all).
        images: of a scene, whether its images are written to, too.
        inputs: folders, relative to `root`, whose entries are links to what is only read.

    Raises:
        ToolkitError: a folder is a symbolic link out of `home`; the message names it.
    """
    home = (home or root).resolve()
    if not root.resolve().is_relative_to(home):
        raise _leads_out(root)
    is_scene = (root / "scene.json").is_file() and not images
    waiting = [(root, 1)]
    while waiting:
        folder, level = waiting.pop()
        if inputs and folder.relative_to(root).as_posix() in inputs:
            continue
        with suppress(FileNotFoundError, PermissionError), os.scandir(folder) as entries:
            for entry in entries:
                if folder == root and is_scene and entry.name in _INPUT_FOLDERS:
                    continue
                if entry.is_symlink() and entry.is_dir():
                    if not Path(entry.path).resolve().is_relative_to(home):
                        raise _leads_out(Path(entry.path))
                elif entry.is_dir(follow_symlinks=False) and level != depth:
                    waiting.append((Path(entry.path), level + 1))


def _leads_out(folder: Path) -> ToolkitError:
    return ToolkitError(
        "the folder is a symbolic link out of its scene or results, and is written to",
        path=folder,
        value=str(folder.resolve()),
        hint="move the files here, or link the whole scene",
    )
