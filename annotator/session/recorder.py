"""The life of a scene's journal: looked at when a session opens, set aside when it ends."""

from __future__ import annotations

from annotator.session.journal import (
    AnyEntry,
    Begun,
    Journal,
    encode_entry,
    journal_path,
    read_journal,
    scene_digests,
    set_aside,
)
from annotator.session.merging import Version
from annotator.session.recovery import Recovery, find_recovery
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import decode_document
from std_toolkit.scene import Scene


class Recorder:
    """Writes entries to the journal of a scene; the file is made with the first one."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._path = journal_path(scene.root)
        # Of the documents as they were when the annotation began.
        self._digests = scene_digests(scene.root)
        self._journal: Journal | None = None

    def look_back(self) -> tuple[Recovery | None, list[str]]:
        """Edits of an earlier session that were not saved, and warnings about its journal.

        A journal with nothing to recover is set aside.

        Raises:
            ToolkitError: the journal cannot be read or moved.
        """
        if not self._path.exists():
            return None, []
        if self._path.parent.is_symlink():
            raise ToolkitError(
                "the journal's folder must not be a symbolic link", path=self._path.parent
            )
        content = read_journal(self._path)
        found = find_recovery(self._scene, content)
        if found is not None:
            return found, []
        reason = "damaged" if content.damage else "saved" if content.begun else "torn"
        kept = set_aside(self._path, self._scene.root, reason)
        if not content.damage:
            return None, []
        return None, [
            f"The journal of an earlier session is damaged ({content.damage}): edits after that "
            f"line cannot be brought back. It is kept as {kept}."
        ]

    def recover(self, found: Recovery) -> None:
        """Go on with the journal of a recovered session."""
        if found.damage:
            set_aside(self._path, self._scene.root, "damaged", keep=True)
        self._journal = Journal.resume(found.content, found.entries)

    def discard(self) -> None:
        """Set the journal that was found aside."""
        set_aside(self._path, self._scene.root, "discarded")

    @property
    def next_number(self) -> int:
        return self._journal.lines if self._journal is not None else 1

    def checked(self, entry: AnyEntry) -> tuple[AnyEntry, bytes]:
        """The entry as it will be read back, and its bytes.

        Raises:
            ToolkitError: it could not be read back: a value of a wrong type or out of range.
        """
        data = encode_entry(entry)
        return decode_document(data, AnyEntry), data  # type: ignore[arg-type]

    def append(self, data: bytes, *, base: Version, like: AnyEntry) -> None:
        """Put an entry on disk; before the first one, what the annotation began with.

        Args:
            data: from `checked`.
            base: documents and state at the start.
            like: the entry; who and when are the same in the first line.

        Raises:
            ToolkitError: the disk is full, or the folder cannot be written any more.
        """
        if self._journal is None:
            begun = Begun(
                number=0,
                time=like.time,
                annotator=like.annotator,
                version=like.version,
                scene=self._scene.info.name,
                digests=self._digests,
                stored=base.stored,
                state=base.state,
            )
            journal = Journal.create(self._path)
            try:
                journal.append(encode_entry(begun))
            except ToolkitError:
                journal.close()
                self._path.unlink(missing_ok=True)
                raise
            self._journal = journal
        self._journal.append(data)

    def close(self, *, outcome: str | None) -> None:
        """End the journal; with an outcome ("saved", "discarded") it is set aside under it."""
        if self._journal is None:
            return
        self._journal.close()
        self._journal = None
        if outcome is not None:
            set_aside(self._path, self._scene.root, outcome)
