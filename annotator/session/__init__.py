"""Headless annotation session: state, edits, undo, journal, saving, scripts."""

from annotator.session.edits import (
    AddClick,
    AddObject,
    AnyEdit,
    ChangeClick,
    ChangeObject,
    ClearPose,
    CompoundEdit,
    EnterModel,
    Move,
    PoseChange,
    RemoveObject,
    SetPoses,
    SetSymmetry,
)
from annotator.session.recovery import Recovery
from annotator.session.saving import SaveReport
from annotator.session.session import Change, PropagateReport, SaveConflict, Session
from annotator.session.state import AnnotationState, Click, ObjectState, Placement, Snapshot

__all__ = [
    "AddClick",
    "AddObject",
    "AnnotationState",
    "AnyEdit",
    "Change",
    "ChangeClick",
    "ChangeObject",
    "ClearPose",
    "Click",
    "CompoundEdit",
    "EnterModel",
    "Move",
    "ObjectState",
    "Placement",
    "PoseChange",
    "PropagateReport",
    "Recovery",
    "RemoveObject",
    "SaveConflict",
    "SaveReport",
    "Session",
    "SetPoses",
    "SetSymmetry",
    "Snapshot",
]
