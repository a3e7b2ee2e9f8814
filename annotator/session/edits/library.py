"""Edits of the mesh library and of the list of objects."""

from __future__ import annotations

import msgspec

from annotator.session.edits.base import Edit, EditContext
from annotator.session.state import AnnotationState, ObjectState, Status
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.document import ObjectId
from std_toolkit.scene.model import Material, Model, SymmetryModel
from std_toolkit.scene.names import check_name


class EnterModel(Edit, frozen=True, kw_only=True, tag="enter_model"):
    """A model whose mesh file is in the scene folder already joins the library."""

    model: Model

    @property
    def title(self) -> str:
        return f"Add mesh {self.model.id}"

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        del context
        return state.with_model(self.model)


class SetSymmetry(Edit, frozen=True, kw_only=True, tag="set_symmetry"):
    """Symmetries of a model, mesh frame, metres."""

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
    """A physical object of a model of the library; it has no pose yet.

    Attributes:
        id: its value in masks; default: the smallest one that nobody has or had.
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
    """The object leaves the scene with its poses and clicks; the mesh stays in the library."""

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
        return msgspec.structs.replace(state, objects=[o for o in state.objects if o.id != gone.id])


class ChangeObject(Edit, frozen=True, kw_only=True, tag="change_object"):
    """Name, material, status or note of an object; what is None stays."""

    object: str
    name: str | None = None
    material: Material | None = None
    status: Status | None = None
    note: str | None = None

    def check(self) -> None:
        if not self._changes:
            raise ToolkitError("nothing to change", hint="give name, material, status or note")

    @property
    def _changes(self) -> dict[str, str]:
        return {
            field: value
            for field in ("name", "material", "status", "note")
            if (value := getattr(self, field)) is not None
        }

    @property
    def title(self) -> str:
        if self.status is not None:
            return f"Mark {self.object} as {self.status}"
        if self.name is not None:
            return f"Rename {self.object} to {self.name}"
        return f"Set {' and '.join(self._changes)} of {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object, *(() if self.name is None else (self.name,)))

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        del context
        thing = state.object(self.object)
        if self.status == "done" and not thing.placements:
            raise ToolkitError(
                "an object without a pose cannot be done",
                field="object",
                value=self.object,
                hint="place it first",
            )
        if self.name is not None and self.name != self.object:
            check_name(self.name)
            _refuse_name(state, self.name, field="name")
        return state.with_object(msgspec.structs.replace(thing, **self._changes))


def _refuse_name(state: AnnotationState, name: str, *, field: str) -> None:
    if any(o.name == name for o in state.objects):
        raise ToolkitError(
            "there is an object of this name", field=field, value=name, hint="choose another"
        )
