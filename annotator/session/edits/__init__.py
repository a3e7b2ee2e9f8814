"""Edits, which map one state to the next, in the format of journal, scripts and undo."""

from __future__ import annotations

import msgspec

from annotator.session.edits.object_edits import (
    AddObject,
    ChangeObject,
    Edit,
    EditContext,
    EnterModel,
    RemoveObject,
    SetSymmetry,
)
from annotator.session.edits.pose_edits import (
    AddClick,
    Axes,
    ChangeClick,
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


class CompoundEdit(Edit, frozen=True, kw_only=True, tag="together"):
    """Several edits as one undo step, applied all or none."""

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

    def resolved(self, state: AnnotationState, context: EditContext) -> CompoundEdit:
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


AnyEdit = SingleEdit | CompoundEdit

__all__ = [
    "AddClick",
    "AddObject",
    "AnyEdit",
    "Axes",
    "ChangeClick",
    "ChangeObject",
    "ClearPose",
    "CompoundEdit",
    "Edit",
    "EditContext",
    "EnterModel",
    "Move",
    "PoseChange",
    "RemoveObject",
    "SetPoses",
    "SetSymmetry",
    "SingleEdit",
    "moved_pose",
]
