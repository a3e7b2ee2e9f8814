"""The edits: each turns one state into the next. One format serves journal, script and undo."""

from __future__ import annotations

import msgspec

from annotator.session.edits.base import Edit, EditContext
from annotator.session.edits.clicks import AddClick, ChangeClick
from annotator.session.edits.library import (
    AddObject,
    ChangeObject,
    EnterModel,
    RemoveObject,
    SetSymmetry,
)
from annotator.session.edits.poses import (
    Axes,
    ClearPose,
    Move,
    PoseChange,
    SetPoses,
    moved_pose,
)
from annotator.session.state import AnnotationState
from std_toolkit.errors import ToolkitError

SingleEdit = (
    EnterModel
    | SetSymmetry
    | AddObject
    | RemoveObject
    | ChangeObject
    | SetPoses
    | Move
    | ClearPose
    | AddClick
    | ChangeClick
)


class Together(Edit, frozen=True, kw_only=True, tag="together"):
    """Several edits as one step of undo: all of them are made, or none."""

    edits: list[SingleEdit]
    label: str = ""

    def check(self) -> None:
        if not self.edits:
            raise ToolkitError("no edit is given", field="edits")

    @property
    def title(self) -> str:
        return self.label or self.edits[0].title

    @property
    def objects(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for edit in self.edits for name in edit.objects))

    def resolved(self, state: AnnotationState, context: EditContext) -> Together:
        done: list[SingleEdit] = []
        for edit in self.edits:
            step: SingleEdit = edit.resolved(state, context)  # type: ignore[assignment]
            state = step.apply(state, context)
            done.append(step)
        return msgspec.structs.replace(self, edits=done)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        for edit in self.edits:
            state = edit.apply(state, context)
        return state


AnyEdit = SingleEdit | Together

__all__ = [
    "AddClick",
    "AddObject",
    "AnyEdit",
    "Axes",
    "ChangeClick",
    "ChangeObject",
    "ClearPose",
    "Edit",
    "EditContext",
    "EnterModel",
    "Move",
    "PoseChange",
    "RemoveObject",
    "SetPoses",
    "SetSymmetry",
    "SingleEdit",
    "Together",
    "moved_pose",
]
