"""Undo history with unlimited undo and redo, and the effects of journal entries on it.

Editing and recovery both use `Ledger.plan`, so a recovered state is bitwise equal to the lost one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from annotator.session import journal
from annotator.session.edits import AnyEdit, EditContext
from annotator.session.merge import Merged, Side, Version, _by_id, differ, merge
from annotator.session.saving import WorkTimer
from annotator.session.state import AnnotationState
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3

# Frame ids were checked when the edit was made.
_ANY_FRAME = range(2**53)


@dataclass(frozen=True)
class Effect:
    """Effect of a journal entry.

    Attributes:
        title: displayed name.
        objects: names of the changed objects.
    """

    title: str
    objects: tuple[str, ...] = ()


class Ledger:
    """States with undo and redo, the scene version they started from, and the working time."""

    def __init__(self, base: Version) -> None:
        self.base = base
        self.history = History(base.state)
        self.hands_on = WorkTimer()

    @property
    def state(self) -> AnnotationState:
        return self.history.state

    @property
    def unsaved(self) -> bool:
        """Saving now would change the scene."""
        return differ(self.state, self.base.state)

    def plan(self, entry: journal.AnyEntry) -> Callable[[], Effect]:
        """Compute the effect of an entry; the returned function applies it and cannot fail.

        Raises:
            ToolkitError: the entry is invalid for the state.
        """
        match entry:
            case journal.Edited():
                return self._plan_edit(entry)
            case journal.Undone():
                return self._plan_undo(entry)
            case journal.Redone():
                return self._plan_redo(entry)
            case journal.TakenOver():
                return self._plan_take_over(entry)
            case journal.Reread():
                return self._plan_reread(entry)
            case journal.Saved():
                return lambda: self._save(entry)
            case journal.Resumed():
                return self._resume
            case journal.Begun():
                raise ToolkitError("a journal begins once")

    def _plan_edit(self, entry: journal.Edited) -> Callable[[], Effect]:
        before = self.state
        after = entry.edit.apply(before, _replay_context(entry))
        step = Step(entry.edit.title, entry.edit.objects, after, entry.edit)

        def commit() -> Effect:
            self.history.push(step)
            self._worked(entry.time, step, before)
            return Effect(step.title, step.objects)

        return commit

    def _plan_undo(self, entry: journal.Undone) -> Callable[[], Effect]:
        if self.history.undoable is None:
            raise ToolkitError("there is nothing to undo")

        def commit() -> Effect:
            before = self.state
            step = self.history.undo()
            self._worked(entry.time, step, before)
            return Effect(step.title, step.objects)

        return commit

    def _plan_redo(self, entry: journal.Redone) -> Callable[[], Effect]:
        if self.history.redoable is None:
            raise ToolkitError("there is nothing to redo")

        def commit() -> Effect:
            before = self.state
            step = self.history.redo()
            self._worked(entry.time, step, before)
            return Effect(step.title, step.objects)

        return commit

    def _plan_take_over(self, entry: journal.TakenOver) -> Callable[[], Effect]:
        theirs = Version(entry.stored, entry.state)
        history = self.history.copy()
        merged = take_over(self.base, history, theirs, prefer=entry.prefer)

        def commit() -> Effect:
            self.history, self.base = history, theirs
            return Effect("Take over changes of others", merged.taken)

        return commit

    def _plan_reread(self, entry: journal.Reread) -> Callable[[], Effect]:
        theirs = Version(entry.stored, entry.state)
        before = self.state
        merged = merge(self.base, before, theirs, prefer="mine")

        def commit() -> Effect:
            self.base = theirs
            if differ(merged.state, before):
                self.history.push(Step(entry.title, merged.taken, merged.state))
            return Effect(entry.title, merged.taken)

        return commit

    def _save(self, entry: journal.Saved) -> Effect:
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


def _replay_context(entry: journal.Edited) -> EditContext:
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


@dataclass(frozen=True)
class Step:
    """Applied edit in the undo history.

    Attributes:
        title: displayed name.
        objects: names of the changed objects.
        state: resulting state.
        edit: resolved edit; None if the step is a change read from the scene.
    """

    title: str
    objects: tuple[str, ...]
    state: AnnotationState
    edit: AnyEdit | None = None


class History:
    """Undo history. States are immutable and share unchanged parts, so it needs little memory."""

    def __init__(self, start: AnnotationState) -> None:
        self._start = start
        self._steps: list[Step] = []
        self._done = 0

    def copy(self) -> History:
        twin = History(self._start)
        twin._steps, twin._done = list(self._steps), self._done
        return twin

    @property
    def state(self) -> AnnotationState:
        return self._steps[self._done - 1].state if self._done else self._start

    @property
    def undoable(self) -> Step | None:
        """The step that `undo` would undo, or None."""
        return self._steps[self._done - 1] if self._done else None

    @property
    def redoable(self) -> Step | None:
        """The step that `redo` would redo, or None."""
        return self._steps[self._done] if self._done < len(self._steps) else None

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps that are not undone, oldest first."""
        return tuple(self._steps[: self._done])

    @property
    def states(self) -> tuple[AnnotationState, ...]:
        """All states reachable by undo and redo, oldest first."""
        return (self._start, *(step.state for step in self._steps))

    def rebase(self, change: Callable[[AnnotationState], AnnotationState]) -> None:
        """Apply `change` to every state, as if the initial scene had been different."""
        self._start = change(self._start)
        self._steps = [replace(step, state=change(step.state)) for step in self._steps]

    def push(self, step: Step) -> None:
        """Append a step and drop the steps that could be redone."""
        del self._steps[self._done :]
        self._steps.append(step)
        self._done += 1

    def undo(self) -> Step:
        """Undo a step; raises ToolkitError if there is nothing to undo."""
        step = self.undoable
        if step is None:
            raise ToolkitError("there is nothing to undo")
        self._done -= 1
        return step

    def redo(self) -> Step:
        """Redo a step; raises ToolkitError if there is nothing to redo."""
        step = self.redoable
        if step is None:
            raise ToolkitError("there is nothing to redo")
        self._done += 1
        return step


def conflicts(base: Version, history: History, theirs: Version) -> tuple[str, ...]:
    """Return the conflicts that `take_over` would resolve for one side.

    Raises:
        ToolkitError: as `take_over`.
    """
    renumber = _renumbering(base, history, theirs)
    return merge(base, renumber(history.state), theirs, prefer="mine").conflicts


def take_over(base: Version, history: History, theirs: Version, *, prefer: Side) -> Merged:
    """Merge changes by others into every state of the history, as if they preceded our edits.

    Undo therefore reverts our edits only, never theirs. Dropping our version in a conflict is an
    additional step, so that undo restores it. On an error nothing has changed.

    Raises:
        ToolkitError: an object of theirs has the same name as a different object of ours.
    """
    renumber = _renumbering(base, history, theirs)
    before = renumber(history.state)
    merged = merge(base, before, theirs, prefer=prefer)

    def change(state: AnnotationState) -> AnnotationState:
        try:
            return merge(base, renumber(state), theirs, prefer="mine").state
        except ToolkitError:
            # An older state of ours that cannot be merged with theirs: theirs must not be undone.
            return theirs.state

    history.rebase(change)
    if prefer == "theirs" and merged.conflicts:
        names = {o.name: None for state in (before, merged.state) for o in state.objects}
        given_up = tuple(name for name in names if name in merged.conflicts)
        history.push(Step("Keep the changes of others", given_up, merged.state))
    return merged


def _renumbering(
    base: Version, history: History, theirs: Version
) -> Callable[[AnnotationState], AnnotationState]:
    """Assign new ids in every state to our objects whose ids the others also used."""
    known, new = _by_id(base.state), _by_id(theirs.state)
    named = {o.name: o.id for i, o in new.items() if i not in known}
    used = {o.id for state in history.states for o in state.objects} | set(known) | set(new)
    # Objects are matched by name in the current state.
    change = {
        o.id: named[o.name]
        for o in history.state.objects
        if o.id not in known and named.get(o.name, o.id) != o.id
    }
    for obj in (o for state in (history.state, *history.states) for o in state.objects):
        if obj.id in known or obj.id in change:
            continue
        if obj.id in new and new[obj.id].name != obj.name:
            change[obj.id] = _free(used)
            used.add(change[obj.id])

    def renumbered(state: AnnotationState) -> AnnotationState:
        if not any(o.id in change for o in state.objects):
            return state
        objects = [msgspec.structs.replace(o, id=change.get(o.id, o.id)) for o in state.objects]
        return msgspec.structs.replace(state, objects=sorted(objects, key=lambda o: o.id))

    return renumbered


def _free(used: Iterable[int]) -> int:
    taken = set(used)
    for number in range(1, 255):
        if number not in taken:
            return number
    raise ToolkitError("no object id is free", hint="a scene holds 254 objects at most")
