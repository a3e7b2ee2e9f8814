"""What the entries of a journal do to the state: the same code while editing and while recovering.

That both go through `Ledger.plan` is what makes a recovered state equal the lost one bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotator.session.edits import EditContext
from annotator.session.hands_on import HandsOn
from annotator.session.history import History, Step
from annotator.session.journal import (
    AnyEntry,
    Begun,
    Edited,
    Redone,
    Reread,
    Resumed,
    Saved,
    TakenOver,
    Undone,
)
from annotator.session.merging import Version, differ, merge, take_over
from annotator.session.state import AnnotationState
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3

# Whether a frame exists was asked when the edit was made.
_ANY_FRAME = range(2**53)


@dataclass(frozen=True)
class Effect:
    """What an entry did.

    Attributes:
        title: for people.
        objects: names of the objects concerned.
    """

    title: str
    objects: tuple[str, ...] = ()


class Ledger:
    """States with undo and redo, the version of the scene they started from, and hours worked."""

    def __init__(self, base: Version) -> None:
        self.base = base
        self.history = History(base.state)
        self.hands_on = HandsOn()

    @property
    def state(self) -> AnnotationState:
        return self.history.state

    @property
    def unsaved(self) -> bool:
        """Saving now would change the scene."""
        return differ(self.state, self.base.state)

    def plan(self, entry: AnyEntry) -> Callable[[], Effect]:
        """What the entry will do: everything that can fail is done, and nothing has changed yet.

        Raises:
            ToolkitError: the entry does not fit the state.
        """
        match entry:
            case Edited():
                return self._plan_edit(entry)
            case Undone():
                return self._plan_undo(entry)
            case Redone():
                return self._plan_redo(entry)
            case TakenOver():
                return self._plan_take_over(entry)
            case Reread():
                return self._plan_reread(entry)
            case Saved():
                return lambda: self._save(entry)
            case Resumed():
                return self._resume
            case Begun():
                raise ToolkitError("a journal begins once")

    def _plan_edit(self, entry: Edited) -> Callable[[], Effect]:
        before = self.state
        after = entry.edit.apply(before, _replay_context(entry))
        step = Step(entry.edit.title, entry.edit.objects, after, entry.edit)

        def commit() -> Effect:
            self.history.push(step)
            self._worked(entry.time, step, before)
            return Effect(step.title, step.objects)

        return commit

    def _plan_undo(self, entry: Undone) -> Callable[[], Effect]:
        if self.history.undoable is None:
            raise ToolkitError("there is nothing to undo")

        def commit() -> Effect:
            before = self.state
            step = self.history.undo()
            self._worked(entry.time, step, before)
            return Effect(step.title, step.objects)

        return commit

    def _plan_redo(self, entry: Redone) -> Callable[[], Effect]:
        if self.history.redoable is None:
            raise ToolkitError("there is nothing to redo")

        def commit() -> Effect:
            before = self.state
            step = self.history.redo()
            self._worked(entry.time, step, before)
            return Effect(step.title, step.objects)

        return commit

    def _plan_take_over(self, entry: TakenOver) -> Callable[[], Effect]:
        theirs = Version(entry.stored, entry.state)
        history = self.history.copy()
        merged = take_over(self.base, history, theirs, prefer=entry.prefer)

        def commit() -> Effect:
            self.history, self.base = history, theirs
            return Effect("Take over changes of others", merged.taken)

        return commit

    def _plan_reread(self, entry: Reread) -> Callable[[], Effect]:
        theirs = Version(entry.stored, entry.state)
        before = self.state
        merged = merge(self.base, before, theirs, prefer="mine")

        def commit() -> Effect:
            self.base = theirs
            if differ(merged.state, before):
                self.history.push(Step(entry.title, merged.taken, merged.state))
            return Effect(entry.title, merged.taken)

        return commit

    def _save(self, entry: Saved) -> Effect:
        written = [
            x.object
            for x in entry.stored.labels.labels
            if x != self.base.stored.labels.of(x.object)
        ]
        self.hands_on.saved(written)
        self.base = Version(entry.stored, self.state)
        return Effect("Save")

    def _resume(self) -> Effect:
        self.hands_on.pause()
        return Effect("Recover")

    def _worked(self, time: str, step: Step, before: AnnotationState) -> None:
        ids = {o.id for s in (before, self.state) for o in s.objects if o.name in step.objects}
        self.hands_on.edited(time, sorted(ids))


def _replay_context(entry: Edited) -> EditContext:
    return EditContext(
        frames=_ANY_FRAME,
        pose=_unresolved,
        centre=_unresolved_centre,
        shared=entry.shared,
        annotator=entry.annotator,
        time=entry.time,
    )


def _unresolved(state: AnnotationState, name: str, frame: int) -> SE3 | None:
    del state, name, frame
    raise ToolkitError("the journal holds an edit that depends on camera poses")


def _unresolved_centre(model: str) -> NDArray[np.float64]:
    del model
    raise ToolkitError("the journal holds an edit that depends on a mesh")
