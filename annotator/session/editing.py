"""Edits, undo and redo; each is written to the journal on disk before it takes effect."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any, Literal

from annotator.session import ledger, merge, recovery
from annotator.session.edits import AnyEdit, EditContext
from annotator.session.journal import (
    AnyEntry,
    Begun,
    Edited,
    Journal,
    Redone,
    Undone,
    encode_entry,
    journal_path,
    read_journal,
    scene_digests,
    set_aside,
)
from annotator.session.meshes import MeshLibrary
from annotator.session.state import AnnotationState, Cameras, Judged, Queries, Snapshot
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import decode_document, utc_text
from std_toolkit.scene import Scene
from std_toolkit.scene.judgement import Judgement

if TYPE_CHECKING:
    from annotator.session.requests import Outcome, Request

ChangeKind = Literal["edit", "undo", "redo", "saved", "reread"]


@dataclass(frozen=True)
class Change:
    """Change of a session, reported to listeners.

    Attributes:
        kind: an edit was applied, undone or redone, the labels were saved, or the scene was read
            again.
        title: displayed name of the change.
        objects: names of the changed objects; empty for the scene as a whole.
    """

    kind: ChangeKind
    title: str
    objects: tuple[str, ...]


class Editing(Queries):
    """The state with its history; `Session` adds opening, recovery and saving."""

    def __init__(
        self, scene: Scene, *, annotator: str, by_hand: bool = True, recorder: Recorder | None
    ) -> None:
        self.scene = scene
        self.annotator = annotator
        self._by_hand = by_hand
        self._recorder = recorder
        self._listeners: list[Callable[[Change], None]] = []
        self._meshes = MeshLibrary(scene.root)
        self._poses, self._cameras = scene.poses, Cameras.of(scene)
        stored = merge.Stored.of(scene)
        opened = merge.state_of(scene, self._cameras, stored)
        self.warnings = list(opened.warnings)
        # Verdicts of this session by object id; saved with the labels while they hold.
        self.judged: dict[int, Judged] = {}
        self.recovery: recovery.Recovery | None = None
        self._ledger = ledger.Ledger(merge.Version(stored, opened.state))

    # --- what there is ---------------------------------------------------------------------------

    @property
    def state(self) -> AnnotationState:
        return self._ledger.state

    @property
    def cameras(self) -> Cameras:
        return self._cameras

    @property
    def meshes(self) -> MeshLibrary:
        return self._meshes

    @property
    def writable(self) -> bool:
        """Whether edits can be made and saved."""
        return self._recorder is not None

    @property
    def unsaved(self) -> bool:
        """Whether saving now would change the scene."""
        return self._ledger.unsaved

    @property
    def undoable(self) -> ledger.Step | None:
        return self._ledger.history.undoable

    @property
    def redoable(self) -> ledger.Step | None:
        return self._ledger.history.redoable

    @property
    def steps(self) -> tuple[ledger.Step, ...]:
        """Edits that are not undone, oldest first."""
        return self._ledger.history.steps

    def hands_on_s(self, name: str) -> float:
        """Return the working time on an object since its label was last saved, s; a lower bound."""
        return self._ledger.hands_on.seconds(self.object(name).id)

    def judgement(self, name: str) -> Judgement | None:
        """Return what was measured of an object's present pose, in this session or before."""
        measured = self.judged.get(self.object(name).id)
        return self._cameras.judgement(self.state, name, measured)

    def snapshot(self) -> Snapshot:
        """Return an immutable copy of the session for use in another thread."""
        return Snapshot(
            self.scene,
            self.state,
            self._cameras,
            self._meshes,
            writable=self.writable,
            annotator=self.annotator,
        )

    # --- editing ---------------------------------------------------------------------------------

    def apply(self, edit: AnyEdit) -> None:
        """Apply an edit; it is in the journal on disk when this returns.

        Raises:
            ToolkitError: the edit is invalid for the state, or the journal is not writable; nothing
                has changed then.
        """
        self._require_editable()
        context = self._context()
        resolved = edit.resolved(self.state, context)
        resolved.apply(self.state, context)
        self._record("edit", Edited, edit=resolved, shared=self.posed, time=context.time)

    def undo(self) -> None:
        """Undo the last edit; raises ToolkitError if there is none, or as `apply`."""
        self._require_editable()
        self._record("undo", Undone)

    def redo(self) -> None:
        """Redo the last undone edit; raises ToolkitError if there is none, or as `apply`."""
        self._require_editable()
        self._record("redo", Redone)

    def perform(self, request: Request) -> Outcome:
        """Compute a request and apply the resulting edit; blocks until done.

        Raises:
            ToolkitError: the request fails.
        """
        self._require_editable()
        outcome = request.resolve(self.snapshot())
        self.apply(outcome.edit)
        return outcome

    def subscribe(self, listener: Callable[[Change], None]) -> Callable[[], None]:
        """Call `listener` after every change; returns a function that unsubscribes it."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    # --- inner workings --------------------------------------------------------------------------

    def _record(
        self,
        kind: ChangeKind,
        make: Callable[..., AnyEntry],
        *,
        quiet: bool = False,
        time: str | None = None,
        **fields: Any,
    ) -> ledger.Effect:
        """Write an entry to the journal, then apply it; on an error nothing has changed."""
        recorder = self._recorder
        assert recorder is not None
        entry, data = recorder.checked(
            make(
                number=recorder.next_number,
                time=time or utc_text(timespec="milliseconds"),
                annotator=self.annotator,
                version=__version__,
                **fields,
            )
        )
        commit = self._ledger.plan(entry)
        recorder.append(data, base=self._ledger.base, like=entry)
        effect = commit()
        if not quiet:
            self._tell(Change(kind, effect.title, effect.objects))
        return effect

    def _tell(self, change: Change) -> None:
        for listener in list(self._listeners):
            listener(change)

    def _context(self) -> EditContext:
        return EditContext(
            frames=self._cameras.frame_set,
            pose=self._cameras.pose,
            centre=self.centre,
            shared=self.posed,
            annotator=self.annotator,
            time=self._time(),
            reserved=self._ids_in_use,
        )

    def _time(self) -> str:
        """Time of an edit, after that of every pose there is: a clock may be set back."""
        now = utc_text(timespec="milliseconds")
        placed = (p.time for o in self.state.objects for p in o.placements.values())
        newest = max(placed, default="")
        if now <= newest:
            with suppress(ValueError, OverflowError):  # a time of another program
                later = datetime.fromisoformat(newest) + timedelta(milliseconds=1)
                return utc_text(later, timespec="milliseconds")
        return now

    def _ids_in_use(self) -> set[int]:
        on_disk = {o.id for o in self._ledger.base.stored.objects.objects}
        return on_disk.union(o.id for s in self._ledger.history.states for o in s.objects)

    def _require_editable(self) -> None:
        if self._recorder is None:
            raise ToolkitError(
                "the scene is open read-only: nothing can be edited or saved",
                path=self.scene.root,
                hint="open it without read-only",
            )
        if self.recovery is not None:
            raise ToolkitError(
                f"decide first about earlier edits: {self.recovery}",
                path=self.scene.root,
                hint="recover or discard them",
            )


class Recorder:
    """Writes entries to the journal of a scene; the first entry creates the file."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._path = journal_path(scene.root)
        # Digests of the documents at the start of the annotation.
        self._digests = scene_digests(scene.root)
        self._journal: Journal | None = None

    def look_back(self) -> tuple[recovery.Recovery | None, list[str]]:
        """Return unsaved edits of an earlier session, and warnings about its journal.

        Moves a journal without recoverable edits to the history folder.

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
        found = recovery.find_recovery(self._scene, content)
        if found is not None:
            return found, []
        reason = "damaged" if content.damage else "saved" if content.begun else "torn"
        kept = set_aside(self._path, self._scene.root, reason)
        if not content.damage:
            return None, []
        return None, [
            f"The journal of an earlier session is damaged ({content.damage}): edits after that "
            f"line cannot be recovered. It is kept as {kept}."
        ]

    def recover(self, found: recovery.Recovery) -> None:
        """Continue the journal of a recovered session."""
        if found.damage:
            set_aside(self._path, self._scene.root, "damaged", keep=True)
        self._journal = Journal.resume(found.content, found.entries)

    def discard(self) -> None:
        """Move the existing journal to the history folder."""
        set_aside(self._path, self._scene.root, "discarded")

    @property
    def next_number(self) -> int:
        return self._journal.lines if self._journal is not None else 1

    def checked(self, entry: AnyEntry) -> tuple[AnyEntry, bytes]:
        """Return the entry as it will be decoded, and its bytes.

        Raises:
            ToolkitError: the entry cannot be decoded: a value has a wrong type or is out of range.
        """
        data = encode_entry(entry)
        return decode_document(data, AnyEntry), data  # type: ignore[arg-type]

    def append(self, data: bytes, *, base: merge.Version, like: AnyEntry) -> None:
        """Write an entry to disk; the first call also writes the initial documents and state.

        Args:
            data: from `checked`.
            base: documents and state at the start.
            like: the entry; the first line gets its annotator and time.

        Raises:
            ToolkitError: the disk is full, or the folder is not writable.
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
        """Close the journal; an outcome ("saved", "discarded") moves it to the history folder."""
        if self._journal is None:
            return
        self._journal.close()
        self._journal = None
        if outcome is not None:
            set_aside(self._path, self._scene.root, outcome)
