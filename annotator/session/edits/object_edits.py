"""Base class of edits, and edits of the mesh library and of the list of objects.

An edit is applied in its resolved form, which contains all inputs as numbers. Replaying a journal
therefore gives a bitwise equal state even if meshes or camera poses have changed. Operations that
need images or a solver are requests (`annotator.session.requests`), whose outcome is an edit.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from annotator.session.state import AnnotationState, ObjectState, Status
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene.document import Document, ObjectId, check_name
from std_toolkit.scene.model import Material, Model, SymmetryModel


@dataclass(frozen=True)
class EditContext:
    """Session data that edits can query.

    Attributes:
        frames: ids of all frames in which a pose can be set.
        pose: returns T_cam_obj of an object in a frame of a state; None if it has none there.
        centre: returns the (3,) centre of a model's bounding box, mesh frame, metres: the centre of
            rotations.
        shared: whether one pose holds for all frames (the scene has metric camera poses).
        annotator: name of the annotator.
        time: UTC, ISO 8601.
        reserved: object ids that a new object must not use: they are in the scene's files, or
            belong to another object in a state reachable by undo.
    """

    frames: Container[int]
    pose: Callable[[AnnotationState, str, int], SE3 | None]
    centre: Callable[[str], NDArray[np.float64]]
    shared: bool
    annotator: str
    time: str
    reserved: Callable[[], Container[int]] = tuple


class Edit(Document, frozen=True, kw_only=True, tag_field="edit"):
    """Base of all edits; `apply` does not modify its input state."""

    @property
    def title(self) -> str:
        """Name of the edit in the undo menu."""
        raise NotImplementedError

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the changed objects; empty for the scene as a whole."""
        return ()

    def resolved(self, state: AnnotationState, context: EditContext) -> Edit:
        """Return the edit with all queries of the context replaced by numbers.

        Raises:
            ToolkitError: as `apply`.
        """
        del state, context
        return self

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        """Return the next state.

        Raises:
            ToolkitError: unknown object, model or frame, or value out of range.
        """
        raise NotImplementedError


class EnterModel(Edit, frozen=True, kw_only=True, tag="enter_model"):
    """Adds a model to the library; its mesh file is already in the scene folder."""

    model: Model

    @property
    def title(self) -> str:
        return f"Add mesh {self.model.id}"

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        del context
        known = next((m for m in state.models if m.id == self.model.id), None)
        if known is not None and known.mesh != self.model.mesh:
            for obj in state.objects:
                if obj.model == known.id:
                    refuse_locked(obj)
        return state.with_model(self.model)


class SetSymmetry(Edit, frozen=True, kw_only=True, tag="set_symmetry"):
    """Sets the symmetries of a model, mesh frame, metres."""

    model: str
    symmetry: SymmetryModel

    @property
    def title(self) -> str:
        return f"Set symmetry of {self.model}"

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        del context
        known = state.model(self.model)
        return state.with_model(msgspec.structs.replace(known, symmetry=self.symmetry))


class AddObject(Edit, frozen=True, kw_only=True, tag="add_object"):
    """Adds an object of a library model, without a pose.

    Attributes:
        id: its value in masks; default: the smallest id that was never used.
    """

    object: str
    model: str
    material: Material = "diffuse"
    id: ObjectId | None = None

    @property
    def title(self) -> str:
        return f"Add {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object,)

    def resolved(self, state: AnnotationState, context: EditContext) -> AddObject:
        taken, reserved = {o.id for o in state.objects}, context.reserved()
        free = [i for i in range(1, 255) if i not in taken and i not in reserved]
        if self.id is None and not free:
            raise ToolkitError("no object id is free", hint="a scene holds 254 objects at most")
        if self.id is not None and self.id not in free:
            raise ToolkitError(
                "this object id is taken", field="id", value=self.id, hint=f"{free[:1]} is free"
            )
        return msgspec.structs.replace(self, id=self.id if self.id is not None else free[0])

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        check_name(self.object, field="object")
        state.model(self.model)
        _refuse_name(state, self.object, field="object")
        number = self.resolved(state, context).id
        assert number is not None
        return state.with_object(
            ObjectState(id=number, name=self.object, model=self.model, material=self.material)
        )


class RemoveObject(Edit, frozen=True, kw_only=True, tag="remove_object"):
    """Removes an object with its poses and clicks; the mesh stays in the library."""

    object: str

    @property
    def title(self) -> str:
        return f"Remove {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object,)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        del context
        gone = state.object(self.object)
        refuse_locked(gone)
        return msgspec.structs.replace(state, objects=[o for o in state.objects if o.id != gone.id])


class ChangeObject(Edit, frozen=True, kw_only=True, tag="change_object"):
    """Changes name, material, status, note or lock of an object; None leaves a field unchanged.

    Attributes:
        locked: whether edits of its pose are refused from now on.
        anyway: mark as done though the pose is not known to fit; a script that does without it
            is refused.
    """

    object: str
    name: str | None = None
    material: Material | None = None
    status: Status | None = None
    note: str | None = None
    locked: bool | None = None
    anyway: bool = False

    def check(self) -> None:
        if not self._changes:
            raise ToolkitError(
                "nothing to change", hint="give name, material, status, note or locked"
            )

    @property
    def _changes(self) -> dict[str, str | bool]:
        return {
            field: value
            for field in ("name", "material", "status", "note", "locked")
            if (value := getattr(self, field)) is not None
        }

    @property
    def title(self) -> str:
        if self.status is not None:
            return f"Mark {self.object} as {self.status}"
        if self.name is not None:
            return f"Rename {self.object} to {self.name}"
        if self.locked is not None:
            return f"{'Lock' if self.locked else 'Unlock'} {self.object}"
        return f"Set {' and '.join(self._changes)} of {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object, *(() if self.name is None else (self.name,)))

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        del context
        obj = state.object(self.object)
        if self.status == "done" and not obj.placements:
            raise ToolkitError(
                "an object without a pose cannot be done",
                field="object",
                value=self.object,
                hint="place it first",
            )
        if self.name is not None and self.name != self.object:
            check_name(self.name)
            _refuse_name(state, self.name, field="name")
        return state.with_object(msgspec.structs.replace(obj, **self._changes))


def refuse_locked(obj: ObjectState) -> None:
    """Raise ToolkitError if the object is locked: its pose must not be changed."""
    if obj.locked:
        raise ToolkitError(
            f"{obj.name} is locked",
            hint='press L to unlock it, or set "locked" to false with change_object in a script',
        )


def _refuse_name(state: AnnotationState, name: str, *, field: str) -> None:
    if any(o.name == name for o in state.objects):
        raise ToolkitError(
            "there is an object of this name", field=field, value=name, hint="choose another"
        )
