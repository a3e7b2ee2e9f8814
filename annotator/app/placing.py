"""Where a mesh lands that is dropped onto an image: upright, on what is under the pointer.

Which way up a mesh stands.

Which way up the meshes of a library were made, as far as some of them tell.

What dropping a mesh or an object onto an image does.

From where a mesh is looked at when it is shown alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from annotator.app.controller import Controller
from annotator.session import AddObject, SetPoses
from annotator.session.edits import CompoundEdit, SingleEdit
from annotator.session.state import Queries
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.scene import Model
from std_toolkit.scene.document import safe_name

if TYPE_CHECKING:
    from std_toolkit.labels.support.plane import Plane

# A table-top camera's usual distance, where nothing tells a better one.
USUAL_DISTANCE_M = 0.7

# The way up as a camera sees it that looks down at the usual slant.
USUAL_UP = (0.0, -0.8, -0.6)

# Sensor depth is looked for so far around the pointer.
_REACH_PX = 12

# An axis of a mesh that leans no more than this against the table's normal is meant to be up.
_UPRIGHT = np.cos(np.deg2rad(20.0))

Array = NDArray[np.float64]

# From the front right and above: of the three sides of a thing most people draw these.
AZIMUTH_DEG, ELEVATION_DEG = 35.0, 24.0


def dropped_pose(
    camera: Camera,
    uv: tuple[float, float],
    vertices: NDArray[np.floating],
    R_cam_obj: NDArray[np.floating],
    *,
    depth: NDArray[np.floating] | None = None,
    table: Plane | None = None,
) -> SE3:
    """T_cam_obj of a mesh dropped at a pixel: the middle of its bounding box appears there.

    On a table that is known it stands on it; else it lies behind what the sensor saw there, or at
    the usual distance.

    Args:
        camera: intrinsics of the frame.
        uv: pixel under the pointer, lens distortion included.
        vertices: (N, 3) of the mesh, metres.
        R_cam_obj: (3, 3) how it is turned.
        depth: (H, W) sensor depth of the frame, metres, or None.
        table: the table in this camera's frame, or None.
    """
    ray = camera.unproject(np.asarray(uv, dtype=np.float64))
    R = np.asarray(R_cam_obj, dtype=np.float64)
    points = np.asarray(vertices, dtype=np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    if table is not None:
        # The middle as high above the table as above the mesh's lowest point.
        height = float(np.max((centre - points) @ (R.T @ table.normal)))
        slope = float(table.normal @ ray)
        distance = (height - table.offset) / slope if abs(slope) > 1e-6 else -1.0
        if 0.05 < distance < 5:
            return SE3(R, ray * distance - R @ centre)
    z = _depth_near(depth, uv)
    # The sensor sees the front; the centre lies half a mesh behind it.
    reach = float(np.linalg.norm(high - low)) / 4 if z is not None else 0.0
    return SE3(R, ray * ((z or USUAL_DISTANCE_M) + reach) - R @ centre)


def upright_rotation(up_cam: ArrayLike, axis: int = 2) -> NDArray[np.float64]:
    """R_cam_obj (3, 3) of a mesh that stands upright, seen from its front.

    Args:
        up_cam: (3,) the way up in the camera's frame.
        axis: the mesh axis that is up (0, 1, 2). The next but one axis points away from the
            camera if z is up, and the next one towards it if y is: the front, as data sets have
            it.
    """
    up = np.asarray(up_cam, dtype=np.float64)
    up = up / np.linalg.norm(up)
    away = np.array([0.0, 0.0, 1.0])
    away = away - (away @ up) * up
    if np.linalg.norm(away) < 1e-3:  # looked at from straight above
        away = np.array([0.0, -1.0, 0.0]) + up[1] * up
    away /= np.linalg.norm(away)
    right = np.cross(away, up)
    # Columns: the mesh's x, y and z axes in the camera's frame.
    if axis == 2:
        columns = [right, away, up]
    elif axis == 1:
        columns = [right, up, -away]
    else:
        columns = [up, away, -right]
    return np.stack(columns, axis=1)


def _depth_near(depth: NDArray[np.floating] | None, uv: tuple[float, float]) -> float | None:
    """Median of the sensor depth around a pixel, metres; None if there is none."""
    if depth is None:
        return None
    u, v = (round(x) for x in uv)
    part = depth[
        max(v - _REACH_PX, 0) : v + _REACH_PX + 1, max(u - _REACH_PX, 0) : u + _REACH_PX + 1
    ]
    measured = part[part > 0]
    return float(np.median(measured)) if len(measured) >= 5 else None


def up_axis(own: int | None, *others: Iterable[int | None]) -> int:
    """The coordinate axis (0, 1, 2) of a mesh that is up when it is shown or placed.

    Args:
        own: the axis about which its shape is turned; None where that does not tell.
        others: the axes that are up in meshes that most likely follow the same habit; of several
            groups the first that tells anything decides. Where none does, z is up.
    """
    if own is not None:
        return own
    for group in others:
        axes = [axis for axis in group if axis is not None]
        if axes:
            return max(sorted(set(axes)), key=axes.count)
    return 2


def standing_axis(session: Queries, model: Model) -> int:
    """The coordinate axis of a model that is up where it is shown alone.

    As it is placed, as long as nothing else is.

    Raises:
        ToolkitError: its mesh cannot be read.
    """
    own = session.meshes.round_axis(model)
    return up_axis(own, () if own is not None else library_axes(session))


def library_axes(session: Queries) -> list[int]:
    """The axes about which the round meshes of a session's or snapshot's library are turned.

    The meshes of one data set have the same axis up, so that these tell it for boxes, too. Reads
    every mesh that was not read before.
    """
    axes = []
    for model in session.state.models:
        try:
            axis = session.meshes.round_axis(model)
        except ToolkitError:  # told where the mesh itself is wanted
            continue
        if axis is not None:
            axes.append(axis)
    return axes


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
        if c.apply(CompoundEdit(edits=edits, label=f"Add {name}")):
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
    for obj in c.session.state.objects:
        pose = c.session.pose(obj.name, frame)
        if pose is None:
            continue
        if obj.model == model_id:
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


def front_rotation(axis: int) -> Array:
    """(3, 3) mesh axes into eye axes (x right, y down, z forward), the mesh standing upright.

    Args:
        axis: the coordinate axis of the mesh (0, 1, 2) that is up.
    """
    azimuth, elevation = np.deg2rad([AZIMUTH_DEG, ELEVATION_DEG])
    up = np.array([0.0, -np.cos(elevation), -np.sin(elevation)])
    rotation: Array = so3_exp(-azimuth * up) @ upright_rotation(up, axis)
    return rotation
