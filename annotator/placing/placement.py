"""What dropping a mesh or an object onto an image does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from annotator.desk.controller import Controller
from annotator.placing.dropping import USUAL_UP, dropped_pose, upright_rotation
from annotator.placing.standing import library_axes
from annotator.placing.upright import up_axis
from annotator.session import AddObject, SetPoses
from annotator.session.edits import SingleEdit, Together
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene.names import safe_name

if TYPE_CHECKING:
    from std_toolkit.labels.support.plane import Plane

# An axis of a mesh that leans no more than this against the table's normal is meant to be up.
_UPRIGHT = np.cos(np.deg2rad(20.0))


def drop_model(c: Controller, model_id: str, frame: int, uv: tuple[float, float]) -> bool:
    """A mesh of the library lands on an image: an object of it is placed there, as one edit.

    The selected object is placed if it is of this mesh and has no pose yet, else any such object;
    where there is none, a new one joins the list.

    Args:
        frame: the frame whose image it was dropped onto.
        uv: pixel of the recorded image.
    """
    waiting = [
        o.name
        for o in c.session.state.objects
        if o.model == model_id and c.session.pose(o.name, frame) is None
    ]
    if waiting:
        return drop_object(c, c.selected if c.selected in waiting else waiting[0], frame, uv)
    name = _free_name(c, model_id)

    def place() -> None:
        pose = _landing(c, model_id, frame, uv)
        edits: list[SingleEdit] = [
            AddObject(object=name, model=model_id),
            SetPoses.one(name, frame, pose, method="drop"),
        ]
        if c.apply(Together(edits=edits, label=f"Add {name}")):
            c.select(name)

    return c.attempt(place)


def drop_object(c: Controller, name: str, frame: int, uv: tuple[float, float]) -> bool:
    """An object of the list lands on an image; one that has a pose keeps how it is turned."""

    def place() -> None:
        known = c.session.pose(name, frame)
        model_id = c.session.object(name).model
        pose = _landing(c, model_id, frame, uv, R_cam_obj=None if known is None else known.R)
        if c.apply(SetPoses.one(name, frame, pose, method="drop")):
            c.select(name)

    return c.attempt(place)


def add_object(c: Controller, model_id: str) -> bool:
    """A mesh of the library becomes an object where the main view looks at."""
    camera = c.session.scene.camera(c.session.scene.frame(c.frame))
    return drop_model(c, model_id, c.frame, (camera.width / 2, camera.height / 2))


def _landing(
    c: Controller,
    model_id: str,
    frame: int,
    uv: tuple[float, float],
    *,
    R_cam_obj: NDArray[np.float64] | None = None,
) -> SE3:
    if frame not in c.session.frames:
        raise ToolkitError(
            "objects cannot be placed in this frame: it has no camera pose",
            value=frame,
            hint="choose another frame below the image",
        )
    scene = c.session.scene
    row = scene.frame(frame)
    try:
        depth = scene.read_depth(row)
    except ToolkitError:
        # The image is there, so the mesh can be placed by it.
        depth = None
    table = table_in(c, frame)
    if R_cam_obj is None:
        R_cam_obj = _first_rotation(c, model_id, frame, table)
    vertices = np.asarray(c.session.mesh(model_id).vertices)
    return dropped_pose(scene.camera(row), uv, vertices, R_cam_obj, depth=depth, table=table)


def _first_rotation(
    c: Controller, model_id: str, frame: int, table: Plane | None
) -> NDArray[np.float64]:
    """How a mesh is turned that was not placed before.

    As another object of the same mesh; else upright, by its shape, by how objects of other meshes
    stand, by the round meshes of the library, or with z up.
    """
    up_cam = np.asarray(USUAL_UP if table is None else table.normal)
    axes: list[int] = []
    for thing in c.session.state.objects:
        pose = c.session.pose(thing.name, frame)
        if pose is None:
            continue
        if thing.model == model_id:
            return np.asarray(pose.R, dtype=np.float64)
        along = pose.R.T @ up_cam
        axes += [int(np.argmax(along))] if along.max() > _UPRIGHT * np.linalg.norm(up_cam) else []
    own = c.session.meshes.round_axis(c.session.state.model(model_id))
    library = () if own is not None or axes else library_axes(c.session)
    return upright_rotation(up_cam, up_axis(own, axes, library))


def table_in(c: Controller, frame: int) -> Plane | None:
    """The table in the coordinates of a frame's camera, as far as it is known."""
    from std_toolkit.labels.support.plane import WORLD, camera_frame_name

    if c.table is None:
        return None
    plane, here = c.table.plane, camera_frame_name(frame)
    T_world_cam = c.session.T_world_cam(frame)
    if plane.frame == here:
        return plane
    if plane.frame != WORLD or T_world_cam is None:
        return None
    return plane.moved(T_world_cam.inverse(), here)


def _free_name(c: Controller, model_id: str) -> str:
    taken = {o.name for o in c.session.state.objects}
    name = safe_name(model_id)
    candidates = [name, *(f"{name}_{i}" for i in np.arange(2, 256))]
    return next(n for n in candidates if n not in taken)
