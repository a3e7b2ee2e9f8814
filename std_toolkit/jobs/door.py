"""What a command may read and write: looked at before anything is done.

`Program` opens the door for every command, from the options themselves: an option that is written
to says so in its metadata, `{"writes": Writes(...)}`; all others are inputs. Inputs and outputs
must be regular files or folders: a pipe could be waited for without end, a device read for ever, or
replaced.
"""

import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import check_vacant, refuse_links
from std_toolkit.io.documents import digest_file, read_document, write_document
from std_toolkit.io.locks import hold_lock

FOLDER = ".std"
WRITTEN = "written.json"

_SCENE = "scene.json"
_PARTS = 3  # levels of folders above those of the parts
_FILE_OF_CODE = re.compile(r"(.+\.py):\w+")

# Folders that this process holds already, as a step that a command calls.
_held: set[Path] = set()


@dataclass(frozen=True)
class Writes:
    """What an option of a command is written to.

    Attributes:
        kind: `new` is a folder that must not exist or be empty. `results` is a folder that one
            program at a time fills and goes on with; with other content it is refused. `parts` is
            one whose parts the step itself locks and identifies. `files` is any folder that
            receives a few files, which are never those of the user; one program at a time. `file`
            is a file that is replaced, `place` a file or a new folder. `scene` is a scene, which
            the step locks.
        marks: entries by one of which a folder of results of an earlier version is known.
        suffix: that the name of a file must have, so that files of another kind are not replaced.
        inputs: folders in it whose entries are links to inputs, which are only read.
    """

    kind: Literal["new", "results", "parts", "files", "file", "place", "scene"]
    marks: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    suffix: str = ""


def regular(path: Path | str, *, field: str | None = None) -> os.stat_result | None:
    """Check that a path is a file, a folder, or nothing yet.

    Raises:
        ToolkitError: it is a pipe, a socket or a device.
    """
    try:
        status = Path(path).stat()
    except (OSError, ValueError):
        return None
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        raise ToolkitError(
            "is neither a file nor a folder but a pipe or device",
            path=path,
            field=field,
            hint="write its content to a file first",
        )
    return status


@contextmanager
def opened(options: Iterable[tuple[str, Any, Mapping[str, Any]]], program: str) -> Iterator[None]:
    """Look at all options of a command, and hold the folders that it fills.

    Args:
        options: title, value and metadata of each.
        program: name of the command, for locks and errors.

    Raises:
        ToolkitError: an input or output cannot be used.
    """
    with ExitStack() as held:
        outputs, inputs = [], set()
        for title, value, metadata in options:
            items = value if isinstance(value, tuple) else (value,)
            for item in items:
                if isinstance(item, Path | str):
                    file = _FILE_OF_CODE.fullmatch(str(item))
                    status = regular(file[1] if file else item, field=title)
                    if status is not None and "writes" not in metadata:
                        inputs.add((status.st_dev, status.st_ino))
            if "writes" in metadata and value is not None:
                outputs += [(title, Path(item), metadata["writes"]) for item in items]
        for title, path, writes in outputs:
            status = regular(path, field=title) if writes.kind == "file" else None
            if status is not None and (status.st_dev, status.st_ino) in inputs:
                raise ToolkitError(
                    "is an input of this command", path=path, field=title, hint="name another file"
                )
            held.enter_context(output(path, writes, program, field=title))
        yield


@contextmanager
def output(path: Path, writes: Writes, program: str, *, field: str | None = None) -> Iterator[None]:
    """Check one output and hold it until the block ends; see `opened`.

    Raises:
        ToolkitError: it cannot be used: it is of another kind, has other content, leads elsewhere
            by a link, or another process holds it.
    """
    status = regular(path, field=field)
    is_folder = status is not None and stat.S_ISDIR(status.st_mode)
    if writes.kind in ("file", "place", "scene"):
        if is_folder and writes.kind == "file":
            raise ToolkitError("is a folder", path=path, field=field, hint="name a file")
        if writes.suffix and path.suffix.lower() != writes.suffix:
            raise ToolkitError(f"must end in {writes.suffix}", path=path, field=field)
        yield
        return
    if status is not None and not is_folder:
        raise ToolkitError("is a file", path=path, field=field, hint="name a folder")
    if writes.kind == "parts":
        refuse_links(path, depth=_PARTS)
    if writes.kind == "new":
        check_vacant(path)
    if writes.kind == "results":
        look(path, [f"{FOLDER}/{_lock(program)}", *writes.marks])
    if writes.kind not in ("results", "files") or path.resolve() in _held:
        yield
        return
    name = _lock(program) if writes.kind == "results" else "files.lock"
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ToolkitError(f"cannot make the folder: {error.strerror}", path=path) from error
    doing, deep = "writing to", writes.kind == "results"
    is_new = not any(path.iterdir())
    with hold_lock(path, name, doing=doing, what="folder", deep=deep, inputs=writes.inputs):
        if is_new:
            write_document(path / FOLDER / WRITTEN, Written(files={}))
        _held.add(path.resolve())
        try:
            yield
        finally:
            _held.discard(path.resolve())


def look(folder: Path, marks: Iterable[str]) -> None:
    """Check, without a look at more than its entries, that a folder is empty or begun before.

    Args:
        folder: need not exist.
        marks: relative paths of which one is there if it was begun before.

    Raises:
        ToolkitError: it holds a scene or other files.
    """
    if not folder.is_dir() or any((folder / mark).exists() for mark in marks):
        return
    others = [p.name for p in folder.iterdir() if p.name[0] != "."]
    if not others:
        return
    kind = "a scene" if _SCENE in others else "files that are not of this command"
    raise ToolkitError(
        f"the folder holds {kind}", path=folder, value=sorted(others)[:3],
        hint="choose another folder",
    )  # fmt: skip


def _lock(program: str) -> str:
    return f"{program.replace(' ', '-')}.lock"


class Written(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`.std/written.json`: files of a folder that commands wrote.

    Attributes:
        files: digest of the content by name; "" while it is being written.
    """

    files: dict[str, str]


def has_record(folder: Path) -> bool:
    """Whether it is known which files of a folder commands wrote."""
    return (folder / FOLDER / WRITTEN).is_file()


def check_own(folder: Path, names: Iterable[str], *, known: Iterable[str] = ()) -> None:
    """Check that no file of these names is the user's, or was changed since it was written.

    Args:
        folder: of the files.
        names: of files that are to be written.
        known: names that are no user's in any case.

    Raises:
        ToolkitError: names the file.
    """
    written, known = _written(folder), set(known)
    for name in names:
        path = folder / name
        if not path.parent.resolve().is_relative_to(folder.resolve()):
            refuse_links(path.parent, home=folder)
        if name in known or not (path.exists() or path.is_symlink()):
            continue
        regular(path)
        ours = written.get(name)
        if ours is None or (ours and (not path.is_file() or digest_file(path) != ours)):
            raise ToolkitError(
                "was changed since it was written" if ours else "is not a file of this command",
                path=path,
                hint="move it away, or choose another folder: it would be replaced",
            )


@contextmanager
def own_files(folder: Path, names: Iterable[str], *, known: Iterable[str] = ()) -> Iterator[None]:
    """Write files of these names in the block: as `check_own`, and they are recorded as written.

    Raises:
        ToolkitError: a file is the user's.
    """
    names = list(names)
    check_own(folder, names, known=known)
    record = folder / FOLDER / WRITTEN
    files = {**_written(folder), **dict.fromkeys(names, "")}
    write_document(record, Written(files=files))
    yield
    there = [name for name in names if (folder / name).is_file()]
    files |= {name: digest_file(folder / name) for name in there}
    write_document(record, Written(files={k: v for k, v in files.items() if v}))


def _written(folder: Path) -> dict[str, str]:
    return read_document(folder / FOLDER / WRITTEN, Written).files if has_record(folder) else {}
