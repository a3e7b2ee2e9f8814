"""Journal of edits, written to disk before an edit takes effect.

`SCENE/.std/annotate/journal.jsonl` is append-only, with one JSON object per line:
`{"check": CRC, "entry": {...}}`. The first entry binds it to the scene. A killed process loses at
most the line that it was writing. Recovery stops at the first line with a wrong checksum.
"""

from __future__ import annotations

import os
import zlib
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import msgspec

from annotator.session.edits import AnyEdit
from annotator.session.merge import Stored
from annotator.session.state import AnnotationState
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import sync_folder, write_bytes_atomic
from std_toolkit.io.documents import digest_files, plain_number
from std_toolkit.scene.document import Count, Document

# Documents that a journal is bound to: changed frames invalidate its edits, changes of the other
# documents are merged.
BOUND_FILES = ("frames.json", "poses.json", "objects.json", "labels.json", "annotation.json")


class Entry(Document, frozen=True, kw_only=True, tag_field="line"):
    """Base of the journal lines.

    Attributes:
        number: line number from 0.
        time: UTC, ISO 8601.
        annotator: name of the annotator.
        version: version of the toolkit that wrote the line.
    """

    number: Count
    time: str
    annotator: str
    version: str

    def check(self) -> None:
        try:
            aware = datetime.fromisoformat(self.time).tzinfo is not None
        except ValueError:
            aware = False
        if not aware:
            raise ToolkitError("not a time with a time zone", field="time", value=self.time)


class Begun(Entry, frozen=True, kw_only=True, tag="begun"):
    """First line.

    Attributes:
        scene: name of the scene.
        digests: digests of the scene's documents at the start, by file; "" for a missing file.
        stored: documents at the start of the annotation.
        state: state of these documents.
    """

    format: Literal["std-annotate-journal"] = "std-annotate-journal"
    layout: Literal[1] = 1
    scene: str
    digests: dict[str, str]
    stored: Stored
    state: AnnotationState


class Edited(Entry, frozen=True, kw_only=True, tag="edit"):
    """Resolved edit.

    Attributes:
        shared: whether one pose held for all frames (the scene had metric camera poses).
    """

    edit: AnyEdit
    shared: bool


class Undone(Entry, frozen=True, kw_only=True, tag="undo"):
    """Undo of the last edit."""


class Redone(Entry, frozen=True, kw_only=True, tag="redo"):
    """Redo of the last undone edit."""


class TakenOver(Entry, frozen=True, kw_only=True, tag="taken_over"):
    """Merge of changes by other processes into every state (`ledger.take_over`)."""

    stored: Stored
    state: AnnotationState
    prefer: Literal["mine", "theirs"]


class Saved(Entry, frozen=True, kw_only=True, tag="save"):
    """Save of the state; `stored` are the documents that the scene has now."""

    stored: Stored


class Reread(Entry, frozen=True, kw_only=True, tag="reread"):
    """Reload of the scene as one undo step."""

    title: str
    stored: Stored
    state: AnnotationState


class Resumed(Entry, frozen=True, kw_only=True, tag="resumed"):
    """Recovery of the edits by a new session."""


AnyEntry = Begun | Edited | Undone | Redone | TakenOver | Saved | Reread | Resumed


class _Line(msgspec.Struct, forbid_unknown_fields=True):
    check: str
    entry: msgspec.Raw


_DECODE_LINE = msgspec.json.Decoder(_Line)
_DECODE_ENTRY: msgspec.json.Decoder[AnyEntry] = msgspec.json.Decoder(AnyEntry)


@dataclass(frozen=True)
class JournalContent:
    """Readable part of a journal.

    Attributes:
        begun: its first line; None if it is incomplete, so that the journal is empty.
        entries: the following lines up to the first damaged one.
        ends: offset in bytes after each complete line, starting with the first line.
        damage: sentence on a damaged line, or "". An incomplete last line is not damage: the
            process died while writing it.
    """

    path: Path
    begun: Begun | None
    entries: tuple[AnyEntry, ...]
    ends: tuple[int, ...]
    damage: str = ""


def journal_path(root: Path) -> Path:
    return root / ".std" / "annotate" / "journal.jsonl"


def history_folder(root: Path) -> Path:
    """Return the folder of finished, discarded and damaged journals."""
    return root / ".std" / "annotate" / "history"


def scene_digests(root: Path) -> dict[str, str]:
    """Return the digests of the documents that a journal is bound to; "" for a missing one."""
    return digest_files(root, [root / name for name in BOUND_FILES])


def encode_entry(entry: Entry) -> bytes:
    """Encode an entry as JSON.

    Raises:
        ToolkitError: the entry could not be decoded, for example because of a non-finite number.
    """
    try:
        return msgspec.json.encode(entry, enc_hook=plain_number)
    except (TypeError, ValueError, OverflowError) as error:
        raise ToolkitError(f"cannot be written to the journal: {error}") from error


def read_journal(path: Path) -> JournalContent:
    """Read a journal up to its end or first damaged line.

    Raises:
        ToolkitError: the file cannot be read.
    """
    if path.is_symlink() or not path.is_file():
        raise ToolkitError(
            "the journal of edits is not a regular file", path=path, hint="move it away"
        )
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ToolkitError(f"cannot read the journal: {error.strerror}", path=path) from error
    entries: list[AnyEntry] = []
    ends: list[int] = []
    at, damage = 0, ""
    while at < len(data):
        end = data.find(b"\n", at)
        if end < 0:
            break
        try:
            entries.append(_decoded(data[at:end], len(entries), path))
        except ToolkitError as error:
            damage = f"line {len(entries) + 1} is damaged ({error.problem})"
            break
        at = end + 1
        ends.append(at)
    begun = entries[0] if entries and isinstance(entries[0], Begun) else None
    if begun is None:
        if entries:
            damage = "line 1 is damaged (it does not begin as a journal)"
        return JournalContent(path, None, (), (), damage)
    return JournalContent(path, begun, tuple(entries[1:]), tuple(ends), damage)


def _decoded(line: bytes, number: int, path: Path) -> AnyEntry:
    try:
        # The checksum replaces further checks of `decode_document`.
        outer = _DECODE_LINE.decode(line)
        raw = bytes(outer.entry)
        if outer.check != _check(raw):
            raise ToolkitError("its check sum does not fit", path=path)
        entry = _DECODE_ENTRY.decode(raw)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        raise ToolkitError(f"{error}", path=path) from error
    if entry.number != number:
        raise ToolkitError("a line before it is missing", path=path)
    return entry


def _check(data: bytes) -> str:
    return f"{zlib.crc32(data):08x}"


class Journal:
    """Journal opened for writing."""

    def __init__(self, path: Path, descriptor: int, length: int, lines: int) -> None:
        self.path = path
        self.lines = lines
        self._descriptor = descriptor
        self._length = length

    @staticmethod
    def create(path: Path) -> Journal:
        """Create a journal; the caller appends `Begun` next.

        Raises:
            ToolkitError: a journal exists, or the folder is not writable.
        """
        if path.parent.is_symlink():
            raise ToolkitError("the journal's folder must not be a symbolic link", path=path.parent)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            descriptor = os.open(path, flags, 0o666)
        except OSError as error:
            raise _write_problem(path, error) from error
        return Journal(path, descriptor, 0, 0)

    @staticmethod
    def resume(content: JournalContent, entries: int) -> Journal:
        """Continue a journal after its first N entries; later ones are truncated.

        Raises:
            ToolkitError: the journal is not writable.
        """
        length = content.ends[entries]
        try:
            descriptor = os.open(content.path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
            os.ftruncate(descriptor, length)
        except OSError as error:
            raise _write_problem(content.path, error) from error
        return Journal(content.path, descriptor, length, entries + 1)

    def append(self, entry: bytes) -> None:
        """Append a line and flush it to disk before returning; on an error nothing is added.

        Raises:
            ToolkitError: the disk is full, or the folder cannot be written any more.
        """
        line = b'{"check":"%s","entry":%s}\n' % (_check(entry).encode(), entry)
        try:
            # Remove the partial line of a failed attempt.
            if os.fstat(self._descriptor).st_size != self._length:
                os.ftruncate(self._descriptor, self._length)
            written = 0
            while written < len(line):
                written += os.pwrite(self._descriptor, line[written:], self._length + written)
            # Flushes data and file length but not the timestamps, which would double the time.
            getattr(os, "fdatasync", os.fsync)(self._descriptor)
            if self._length == 0:
                sync_folder(self.path.parent)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._length)
            raise _write_problem(self.path, error) from error
        self._length += len(line)
        self.lines += 1

    def close(self) -> None:
        os.close(self._descriptor)


def set_aside(path: Path, root: Path, reason: str, *, keep: bool = False) -> Path:
    """Move a journal to the history folder, which is never cleaned; returns its new path.

    Args:
        reason: part of its new name: "saved", "discarded", "damaged".
        keep: copy the journal instead of moving it.

    Raises:
        ToolkitError: the folder is not writable.
    """
    folder = history_folder(root)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        written = datetime.fromtimestamp(path.stat().st_mtime, UTC).strftime("%Y%m%dT%H%M%SZ")
        target = folder / f"{written}-{reason}.jsonl"
        number = 1
        while target.exists():
            number += 1
            target = folder / f"{written}-{reason}-{number}.jsonl"
        if keep:
            write_bytes_atomic(target, path.read_bytes())
        else:
            path.rename(target)
        sync_folder(folder)
        sync_folder(path.parent)
    except OSError as error:
        raise ToolkitError(
            f"cannot move the journal of edits: {error.strerror or error}", path=path
        ) from error
    return target


def _write_problem(path: Path, error: OSError) -> ToolkitError:
    return ToolkitError(
        f"cannot write the journal of edits: {error.strerror or error}",
        path=path,
        hint="the edit was not applied, and all earlier ones are safe; free disk space (or make "
        "the folder writable) and try again",
    )
