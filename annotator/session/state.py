"""What an annotator has made so far, as immutable documents: undo steps back to an older one."""

from __future__ import annotations

import math
from typing import Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene.document import (
    Count,
    Document,
    ObjectId,
    Pose16,
    Vector3,
    check_pose,
    check_unique,
    find_row,
    pose_from_list,
)
from std_toolkit.scene.model import Material, Model
from std_toolkit.scene.names import check_name

Status = Literal["open", "done"]


class Click(Document, frozen=True, kw_only=True):
    """One 2D-3D correspondence.

    Attributes:
        u, v: pixel in the recorded image (lens distortion included), centres at integers.
        point: the same point on the mesh, metres, mesh frame.
    """

    u: float
    v: float
    point: Vector3

    def check(self) -> None:
        # JSON knows no NaN: such a click could not be read back.
        if not all(math.isfinite(x) for x in (self.u, self.v, *self.point)):
            raise ToolkitError("a click needs finite numbers", value=[self.u, self.v, *self.point])


class Placement(Document, frozen=True, kw_only=True):
    """Where an object was put in one frame, and how it came there.

    Attributes:
        T_cam_obj: mesh frame to the camera of the frame, metres.
        method: the last thing that moved it, such as "drag", "typed", "pnp", "refine".
        refinement: sentence on the refinement whose result this is, or "" if a hand moved it since.
        annotator: who did it.
        time: when, UTC, ISO 8601.
    """

    T_cam_obj: Pose16
    method: str = ""
    refinement: str = ""
    annotator: str = ""
    time: str = ""

    def check(self) -> None:
        check_pose(self.T_cam_obj, "T_cam_obj")

    @property
    def pose(self) -> SE3:
        return pose_from_list(self.T_cam_obj)


class ObjectState(Document, frozen=True, kw_only=True):
    """One object of the scene as annotated.

    Attributes:
        id: 1..254, its value in masks.
        placements: by frame id. In a scene with metric camera poses there is at most one, and it
            holds for every frame; otherwise each frame has its own.
        clicks: 2D-3D correspondences by frame id.
        status: "done" when the annotator is content.
        note: free text, such as what to look at again.
    """

    id: ObjectId
    name: str
    model: str
    material: Material
    status: Status = "open"
    note: str = ""
    placements: dict[Count, Placement] = msgspec.field(default_factory=dict)
    clicks: dict[Count, list[Click]] = msgspec.field(default_factory=dict)

    def check(self) -> None:
        check_name(self.name)


class AnnotationState(Document, frozen=True, kw_only=True):
    """Everything that edits change."""

    models: list[Model] = msgspec.field(default_factory=list)
    objects: list[ObjectState] = msgspec.field(default_factory=list)

    def check(self) -> None:
        check_unique([m.id for m in self.models], "models", "id")
        check_unique([o.name for o in self.objects], "objects", "name")
        check_unique([str(o.id) for o in self.objects], "objects", "id")
        for thing in self.objects:
            self.model(thing.model)

    def object(self, name: str) -> ObjectState:
        """Raises ToolkitError, naming the known ones, if there is none."""
        return find_row(self.objects, "name", name, "object")

    def model(self, model_id: str) -> Model:
        """Raises ToolkitError, naming the known ones, if there is none."""
        return find_row(self.models, "id", model_id, "model")

    def model_of(self, name: str) -> Model:
        return self.model(self.object(name).model)

    def with_object(self, thing: ObjectState) -> AnnotationState:
        """A copy in which `thing` replaces the object of its id, or joins the others."""
        kept = [o for o in self.objects if o.id != thing.id]
        return msgspec.structs.replace(self, objects=sorted([*kept, thing], key=lambda o: o.id))

    def with_model(self, model: Model) -> AnnotationState:
        """A copy in which `model` replaces the one of its id, or joins the others."""
        kept = [m for m in self.models if m.id != model.id]
        return msgspec.structs.replace(self, models=sorted([*kept, model], key=lambda m: m.id))
