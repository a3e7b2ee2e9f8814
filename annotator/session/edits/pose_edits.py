"""Edits of poses and of clicked 2D-3D correspondences."""

from __future__ import annotations

from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from annotator.session.edits.object_edits import Edit, EditContext, refuse_locked
from annotator.session.state import AnnotationState, Click, Placement
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.scene import document

Axes = Literal["camera", "object"]


class PoseChange(document.Document, frozen=True, kw_only=True):
    """New pose of one object in a frame.

    Attributes:
        T_cam_obj: mesh frame to the camera of the frame, metres.
        method: origin of the pose, such as "drag", "gizmo", "typed", "pnp", "refine", "snap".
        refinement: sentence on the refinement that computed the pose, or "".
    """

    object: str
    frame: document.Count
    T_cam_obj: document.Pose16
    method: str = "typed"
    refinement: str = ""

    def check(self) -> None:
        document.check_pose(self.T_cam_obj, "T_cam_obj")

    def resolved(self) -> PoseChange:
        """Return the pose with an exact rotation matrix: typed digits are rounded."""
        exact = SE3.from_matrix(self.T_cam_obj).flat()
        return msgspec.structs.replace(self, T_cam_obj=exact)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        if self.frame not in context.frames:
            raise ToolkitError(
                "no pose can be set in this frame",
                field="frame",
                value=self.frame,
                hint="it is not in the scene, or it has no camera pose",
            )
        _check_distance(document.pose_from_list(self.T_cam_obj))
        obj = state.object(self.object)
        refuse_locked(obj)
        kept = {} if context.shared else obj.placements
        placement = Placement(
            T_cam_obj=self.T_cam_obj,
            method=self.method,
            refinement=self.refinement,
            annotator=context.annotator,
            time=context.time,
        )
        return state.with_object(
            msgspec.structs.replace(
                obj,
                placements=dict(sorted({**kept, self.frame: placement}.items())),
                # A moved pose must be checked again.
                status="open",
            )
        )


class SetPoses(Edit, frozen=True, kw_only=True, tag="set_poses"):
    """Sets poses of one or several objects as one undo step."""

    changes: list[PoseChange]
    label: str = ""

    def check(self) -> None:
        if not self.changes:
            raise ToolkitError("no pose is given", field="changes")

    @property
    def title(self) -> str:
        names = ", ".join(self.objects[:3]) + (", ..." if len(self.objects) > 3 else "")
        return self.label or f"Place {names}"

    @property
    def objects(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(c.object for c in self.changes))

    def resolved(self, state: AnnotationState, context: EditContext) -> SetPoses:
        del state, context
        return msgspec.structs.replace(self, changes=[c.resolved() for c in self.changes])

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        for change in self.changes:
            state = change.apply(state, context)
        return state

    @staticmethod
    def one(
        name: str, frame: int, T_cam_obj: SE3, *, method: str, refinement: str = "", label: str = ""
    ) -> SetPoses:
        """Return the edit that sets the pose of one object in `frame` to `T_cam_obj`."""
        change = PoseChange(
            object=name,
            frame=frame,
            T_cam_obj=T_cam_obj.flat(),
            method=method,
            refinement=refinement,
        )
        return SetPoses(changes=[change], label=label)


class Move(Edit, frozen=True, kw_only=True, tag="move"):
    """Keyboard step: a translation, then a rotation about the object's centre.

    Attributes:
        frame: frame of the view.
        axes: "camera": x right, y down, z forward of that frame; "object": the mesh's own axes.
        shift_mm: (3,) along the axes.
        turn_deg: (3,) rotation vector in the axes.
    """

    object: str
    frame: document.Count
    axes: Axes = "camera"
    shift_mm: document.Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    turn_deg: document.Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])

    @property
    def title(self) -> str:
        verb = "Turn" if any(self.turn_deg) else "Move"
        return f"{verb} {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object,)

    def resolved(self, state: AnnotationState, context: EditContext) -> SetPoses:
        obj = state.object(self.object)
        pose = context.pose(state, self.object, self.frame)
        if pose is None:
            raise ToolkitError(
                "this object has no pose in this frame yet",
                field="object",
                value=self.object,
                hint="place it first",
            )
        moved = moved_pose(
            pose,
            context.centre(obj.model),
            axes=self.axes,
            shift=np.asarray(self.shift_mm) / 1000,
            turn=np.deg2rad(self.turn_deg),
        )
        step = SetPoses.one(self.object, self.frame, moved, method="step", label=self.title)
        return step.resolved(state, context)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        return self.resolved(state, context).apply(state, context)


class ClearPose(Edit, frozen=True, kw_only=True, tag="clear_pose"):
    """Removes the pose of an object (in a scene without camera poses: in this frame only)."""

    object: str
    frame: document.Count

    @property
    def title(self) -> str:
        return f"Unplace {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object,)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        obj = state.object(self.object)
        refuse_locked(obj)
        if not obj.placements or not (context.shared or self.frame in obj.placements):
            raise ToolkitError(
                "this object has no pose to remove", field="object", value=self.object
            )
        kept = (
            {} if context.shared else {f: p for f, p in obj.placements.items() if f != self.frame}
        )
        return state.with_object(
            msgspec.structs.replace(obj, placements=kept, status=obj.status if kept else "open")
        )


def moved_pose(
    T_cam_obj: SE3,
    centre: NDArray[np.floating],
    *,
    axes: Axes,
    shift: NDArray[np.floating],
    turn: NDArray[np.floating],
) -> SE3:
    """Translate a pose and rotate it about the object's centre.

    Args:
        centre: (3,) mesh frame, metres: the centre of rotation.
        axes: axes of `shift` (metres) and `turn` (rotation vector, radians).
    """
    c = np.asarray(centre, dtype=np.float64)
    R = so3_exp(turn)
    where = T_cam_obj @ c
    if axes == "camera":
        rotation, where = R @ T_cam_obj.R, where + shift
    else:
        rotation, where = T_cam_obj.R @ R, where + T_cam_obj.R @ np.asarray(shift)
    return SE3(rotation, where - rotation @ c)


def _check_distance(pose: SE3) -> None:
    try:
        document.check_in_front(pose)
    except ToolkitError as error:
        # The original hints refer to pose files, which do not apply here.
        raise ToolkitError(
            error.problem, value=error.value, hint="an object is 1 cm to 20 m from the camera"
        ) from error


class AddClick(Edit, frozen=True, kw_only=True, tag="add_click"):
    """Adds a correspondence of an object in a frame."""

    object: str
    frame: document.Count
    click: Click

    @property
    def title(self) -> str:
        return f"Click a point of {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object,)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        clicks = state.object(self.object).clicks.get(self.frame, [])
        return _with_clicks(state, context, self.object, self.frame, [*clicks, self.click])


class ChangeClick(Edit, frozen=True, kw_only=True, tag="change_click"):
    """Changes a correspondence, or removes it if `click` is None; `index` counts from 0."""

    object: str
    frame: document.Count
    index: document.Count
    click: Click | None = None

    @property
    def title(self) -> str:
        return f"{'Correct' if self.click else 'Remove'} a point of {self.object}"

    @property
    def objects(self) -> tuple[str, ...]:
        return (self.object,)

    def apply(self, state: AnnotationState, context: EditContext) -> AnnotationState:
        clicks = list(state.object(self.object).clicks.get(self.frame, []))
        if self.index >= len(clicks):
            raise ToolkitError(
                "no such point", field="index", value=self.index, hint=f"there are {len(clicks)}"
            )
        clicks[self.index : self.index + 1] = [self.click] if self.click else []
        return _with_clicks(state, context, self.object, self.frame, clicks)


def _with_clicks(
    state: AnnotationState, context: EditContext, name: str, frame: int, clicks: list[Click]
) -> AnnotationState:
    if frame not in context.frames:
        raise ToolkitError("no such frame to click in", field="frame", value=frame)
    obj = state.object(name)
    table = {**obj.clicks, frame: clicks}
    return state.with_object(
        msgspec.structs.replace(obj, clicks={f: c for f, c in sorted(table.items()) if c})
    )
