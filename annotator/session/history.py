"""Undo and redo without limit: the states an annotator went through, and where in them we are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from annotator.session.edits import AnyEdit
from annotator.session.state import AnnotationState
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True)
class Step:
    """One edit that was made.

    Attributes:
        title: what it was, for people.
        objects: names of the objects that it touched.
        state: the one it led to.
        edit: the edit, resolved; None if the step is a change that was read from the scene.
    """

    title: str
    objects: tuple[str, ...]
    state: AnnotationState
    edit: AnyEdit | None = None


class History:
    """States are immutable and share what did not change, so keeping all of them is cheap."""

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
        """The step that `undo` would take back."""
        return self._steps[self._done - 1] if self._done else None

    @property
    def redoable(self) -> Step | None:
        """The step that `redo` would make again."""
        return self._steps[self._done] if self._done < len(self._steps) else None

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps that are in force, oldest first."""
        return tuple(self._steps[: self._done])

    @property
    def states(self) -> tuple[AnnotationState, ...]:
        """Every state that undo and redo can lead to, oldest first."""
        return (self._start, *(step.state for step in self._steps))

    def rebase(self, change: Callable[[AnnotationState], AnnotationState]) -> None:
        """Change every state, as if the scene had always been another one."""
        self._start = change(self._start)
        self._steps = [replace(step, state=change(step.state)) for step in self._steps]

    def push(self, step: Step) -> None:
        """A new step; what could be redone before it is gone."""
        del self._steps[self._done :]
        self._steps.append(step)
        self._done += 1

    def undo(self) -> Step:
        """Raises ToolkitError if there is nothing to undo."""
        step = self.undoable
        if step is None:
            raise ToolkitError("there is nothing to undo")
        self._done -= 1
        return step

    def redo(self) -> Step:
        """Raises ToolkitError if there is nothing to redo."""
        step = self.redoable
        if step is None:
            raise ToolkitError("there is nothing to redo")
        self._done += 1
        return step
