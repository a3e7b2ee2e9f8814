"""Headless annotation session, the only owner of the annotation state.

A front end applies edits and subscribes to changes; it keeps no copy of the state.
"""

from __future__ import annotations

import getpass
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from annotator.session import journal, ledger, merge, recovery, saving, state
from annotator.session.editing import Change, Editing, Recorder
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.io.locks import TAKE_OVER, Held, hold_lock
from std_toolkit.scene import Scene

if TYPE_CHECKING:
    from std_toolkit.options import PropagateOptions

__all__ = ["Change", "PropagateReport", "SaveConflict", "Session", "user_name"]

LOCK = "annotate.lock"


@dataclass(frozen=True)
class PropagateReport:
    """Result of propagating.

    Attributes:
        saved: result of the preceding save.
        lines: one line of text per label.
    """

    saved: saving.SaveReport
    lines: tuple[str, ...]

    def __str__(self) -> str:
        return f"{'; '.join(self.lines)}."


class SaveConflict(ToolkitError):
    """Others changed the same objects as this session; `value` lists the names."""


class Session(Editing):
    """Annotations of one scene with undo and redo; open it with `Session.open`.

    Not thread-safe: it belongs to one thread. Long computations use a `snapshot` and return an
    edit.

    Attributes:
        scene: the scene on disk.
        annotator: name of the annotator.
        recovery: unsaved edits of an earlier session; must be recovered or discarded before the
            first edit.
        warnings: sentences on data that could not be read exactly.
    """

    def __init__(
        self, scene: Scene, *, annotator: str, by_hand: bool = True, recorder: Recorder | None
    ) -> None:
        super().__init__(scene, annotator=annotator, by_hand=by_hand, recorder=recorder)
        self._locks = ExitStack()
        self._held: Held | None = None

    @staticmethod
    def open(
        root: Path | str,
        *,
        annotator: str | None = None,
        recover: Literal["ask", "yes", "no"] = "ask",
        read_only: bool = False,
        by_hand: bool = True,
        take_over: bool = False,
    ) -> Session:
        """Open a scene for annotation; reads no images.

        Args:
            annotator: name of the annotator; default: the user's name.
            recover: handling of unsaved edits of an earlier session: "yes" restores them, "no" sets
                their journal aside, "ask" leaves them in `recovery`.
            read_only: take no lock and allow no edits.
            by_hand: whether a person edits, so that the working time is recorded.
            take_over: take the scene over from a computer that is not heard of any more.

        Raises:
            ToolkitError: there is no scene, a document is damaged, another session has the scene
                open, or the folder is not writable.
        """
        who = annotator if annotator is not None else user_name()
        if read_only:
            return Session(Scene.open(root), annotator=who, by_hand=by_hand, recorder=None)
        with ExitStack() as locks:
            held = _hold(locks, Scene.open(root).root, who, take_over)
            # Read under the lock, to include the last write of an earlier session.
            scene = Scene.open(root)
            recorder = Recorder(scene)
            session = Session(scene, annotator=who, by_hand=by_hand, recorder=recorder)
            session.recovery, warnings = recorder.look_back()
            session.warnings += warnings
            if session.recovery is not None and recover == "yes":
                session.recover()
            elif session.recovery is not None and recover == "no":
                session.discard_recovery()
            session._held, session._locks = held, locks.pop_all()
        return session

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self, *, discard: bool = False) -> None:
        """Close the session. Unsaved edits stay in the journal and can be recovered.

        Args:
            discard: drop unsaved edits; their journal is moved to the history folder.
        """
        if self._recorder is not None:
            unsaved = self.unsaved and not discard
            outcome = None if unsaved else "discarded" if self.unsaved else "saved"
            self._recorder.close(outcome=outcome)
            self._recorder = None
        self._locks.close()

    # --- recovery --------------------------------------------------------------------------------

    def recover(self) -> None:
        """Restore the edits in `recovery`, with undo and redo.

        Changes by others since then are merged unless they conflict; `save` reports conflicts.

        Raises:
            ToolkitError: there is nothing to recover, or the edits belong to another recording.
        """
        found = self._decided()
        if found.problem:
            raise ToolkitError(
                f"the edits cannot be recovered: {found.problem}",
                path=found.content.path,
                hint="discard them; their journal is kept aside",
            )
        assert self._recorder is not None
        theirs = self._ledger.base
        self._recorder.recover(found)
        self._ledger = found.ledger
        self.recovery = None
        self._record("reread", journal.Resumed, quiet=True)
        changed = theirs.stored != self._ledger.base.stored
        # Conflicts are resolved when saving, as in any session.
        if changed and not ledger.conflicts(self._ledger.base, self._ledger.history, theirs):
            self._take_over(theirs, prefer="mine")
        self._tell(Change("reread", "Recover", ()))

    def discard_recovery(self) -> None:
        """Discard the edits in `recovery`; their journal is moved to the history folder.

        Raises:
            ToolkitError: there is nothing to recover.
        """
        self._decided()
        assert self._recorder is not None
        self._recorder.discard()
        self.recovery = None

    # --- saving ----------------------------------------------------------------------------------

    def save(self, *, on_conflict: merge.Side | None = None) -> saving.SaveReport:
        """Save the edits into the scene; undo continues to work.

        Changes by others since the scene was last read are merged unless they conflict.

        Args:
            on_conflict: version to keep of objects that both changed: "mine" or "theirs"; default:
                an error that lists them.

        Raises:
            SaveConflict: there is such a conflict; the edits are unchanged.
            ToolkitError: another process is writing, or the scene is not writable; the edits are
                unchanged.
        """
        self._require_editable()
        if not self.unsaved:
            return saving.SaveReport()
        with self._noticing_cameras(), self.scene.lock():
            sweep_temporaries(self.scene.root)
            self._renew_cameras()
            taken = self._meet_others(on_conflict)
            base = self._ledger.base
            new = saving.documents_of(
                self.state,
                base,
                self._ledger.hands_on if self._by_hand else None,
                self._cameras,
                self.judged,
            )
            files = saving.write_documents(self.scene, new)
            warnings = self._note_saved(new)
        before = {x.object: x for x in base.stored.labels.labels}
        names = {o.id: o.name for o in self.state.objects}
        labelled = [names[x.object] for x in new.labels.labels if before.get(x.object) != x]
        self._tell(Change("saved", "Save", ()))
        return saving.SaveReport(files, tuple(labelled), taken, warnings)

    def reload(self, title: str = "Read the scene again") -> None:
        """Read the scene again, as one undo step.

        Raises:
            SaveConflict: others changed objects with unsaved edits.
            ToolkitError: a document is damaged, or the journal cannot be written.
        """
        self._require_editable()
        with self._noticing_cameras():
            self.scene.reread()
            self._renew_cameras()
            theirs = self._read_version()
            if theirs.stored != self._ledger.base.stored:
                self._refuse_conflict(theirs, hint="save first, and choose which version to keep")
                self._record(
                    "reread", journal.Reread, title=title, stored=theirs.stored, state=theirs.state
                )

    def propagate(self, options: PropagateOptions | None = None) -> PropagateReport:
        """Save, propagate the labels to all registered frames, and read the result.

        Raises:
            ToolkitError: as `save` and `std_toolkit.labels.propagate.propagate_labels`.
        """
        saved = self.save()
        carried = saving.propagate_saved_labels(self.scene.root, options)
        self.reload("Propagate")
        return PropagateReport(saved, (*carried.lines, *carried.warnings))

    def _renew_cameras(self) -> None:
        """Read the current camera poses of the scene."""
        before, self._poses = self._poses, self.scene.poses
        if before != self._poses:
            self._cameras = state.Cameras.of(self.scene)

    @contextmanager
    def _noticing_cameras(self) -> Iterator[None]:
        """Context manager that reports changed camera poses at its end, also after an error."""
        before = self._cameras
        try:
            yield
        finally:
            if self._cameras is not before:
                self._tell(Change("reread", "New camera poses", ()))

    def _meet_others(self, on_conflict: merge.Side | None) -> tuple[str, ...]:
        """Merge changes by others; returns the names of what was merged."""
        theirs = self._read_version()
        if theirs.stored == self._ledger.base.stored:
            return ()
        if on_conflict is None:
            hint = "save again and choose which version to keep (on_conflict: mine or theirs)"
            self._refuse_conflict(theirs, hint=hint)
        return self._take_over(theirs, prefer=on_conflict or "mine").objects

    def _refuse_conflict(self, theirs: merge.Version, *, hint: str) -> None:
        clash = ledger.conflicts(self._ledger.base, self._ledger.history, theirs)
        if clash:
            raise SaveConflict(
                "others changed these in the scene while you edited them",
                path=self.scene.root,
                value=", ".join(clash),
                hint=hint,
            )

    def _take_over(self, theirs: merge.Version, *, prefer: merge.Side) -> ledger.Effect:
        return self._record(
            "reread", journal.TakenOver, stored=theirs.stored, state=theirs.state, prefer=prefer
        )

    def _note_saved(self, new: merge.Stored) -> tuple[str, ...]:
        try:
            self._record("saved", journal.Saved, quiet=True, stored=new)
        except ToolkitError as error:
            # The labels are written. Without this journal line the next session offers to recover
            # them, although the scene has them.
            return (f"The labels are saved, but {error.problem}.",)
        return ()

    def _read_version(self) -> merge.Version:
        stored = merge.Stored.of(self.scene)
        opened = merge.state_of(self.scene, self._cameras, stored)
        self.warnings = list(opened.warnings)
        return merge.Version(stored, opened.state)

    def _require_editable(self) -> None:
        super()._require_editable()
        if self._held is not None:
            self._held.check()

    def _decided(self) -> recovery.Recovery:
        if self.recovery is None:
            raise ToolkitError("there are no edits to recover", path=self.scene.root)
        return self.recovery


def user_name() -> str:
    """Return the name of the user of this computer; "" if unknown."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return ""


def _hold(locks: ExitStack, root: Path, annotator: str, take_over: bool) -> Held:
    note = f"annotator {annotator}" if annotator else ""
    try:
        return locks.enter_context(
            hold_lock(root, LOCK, doing="annotating", note=note, beats=True, take_over=take_over)
        )
    except ToolkitError as error:
        held, dead = "another process" in error.problem, TAKE_OVER in (error.hint or "")
        hint = (
            "close that session first, or open the scene read-only"
            if held
            else ("open it read-only (--read-only)")
        )
        raise error.revised(hint=f"{error.hint}, or open it read-only" if dead else hint) from error
