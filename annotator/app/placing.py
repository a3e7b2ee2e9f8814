"""Initial pose of a mesh dropped onto an image: upright, on the surface under the pointer."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from annotator.app.controller import Controller
from annotator.app.mesh_folder import MeshToPlace, meshes_to_add
from annotator.session import AddObject, SetPoses
from annotator.session.edits import CompoundEdit, SingleEdit
from annotator.session.state import Queries
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.scene import Model
from std_toolkit.scene.document import safe_name

if TYPE_CHECKING:
    from std_toolkit.labels.support.plane import Plane

# Usual distance of a table-top camera, the default.
USUAL_DISTANCE_M = 0.7

# Up direction in a camera that looks down at the usual angle.
USUAL_UP = (0.0, -0.8, -0.6)

# Search radius for sensor depth around the pointer.
_REACH_PX = 12

# A mesh axis with a smaller angle to the table's normal is taken as its up axis.
_UPRIGHT = np.cos(np.deg2rad(20.0))

Array = NDArray[np.float64]

# View from the front right and above, the usual view of a product.
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
    """Return T_cam_obj of a mesh whose bounding box centre projects to the pixel.

    The mesh stands on the table if it is known. Otherwise it is placed behind the sensor depth
    under the pointer, or at the usual distance.

    Args:
        camera: intrinsics of the frame.
        uv: pixel under the pointer, lens distortion included.
        vertices: (N, 3) of the mesh, metres.
        R_cam_obj: (3, 3) rotation of the mesh.
        depth: (H, W) sensor depth of the frame, metres, or None.
        table: the table in this camera's frame, or None.
    """
    ray = camera.unproject(np.asarray(uv, dtype=np.float64))
    R = np.asarray(R_cam_obj, dtype=np.float64)
    points = np.asarray(vertices, dtype=np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    if table is not None:
        # The centre is as high above the table as above the mesh's lowest point.
        height = float(np.max((centre - points) @ (R.T @ table.normal)))
        slope = float(table.normal @ ray)
        distance = (height - table.offset) / slope if abs(slope) > 1e-6 else -1.0
        if 0.05 < distance < 5:
            return SE3(R, ray * distance - R @ centre)
    z = _depth_near(depth, uv)
    # The sensor measures the front; the centre is half a mesh behind it.
    reach = float(np.linalg.norm(high - low)) / 4 if z is not None else 0.0
    return SE3(R, ray * ((z or USUAL_DISTANCE_M) + reach) - R @ centre)


def upright_rotation(up_cam: ArrayLike, axis: int = 2) -> NDArray[np.float64]:
    """Return R_cam_obj (3, 3) of an upright mesh seen from its front.

    Args:
        up_cam: (3,) up direction in the camera's frame.
        axis: the mesh axis that is up (0, 1, 2). If z is up, the next but one axis points away from
            the camera; if y is up, the next one points towards it. Data sets define the front this
            way.
    """
    up = np.asarray(up_cam, dtype=np.float64)
    up = up / np.linalg.norm(up)
    away = np.array([0.0, 0.0, 1.0])
    away = away - (away @ up) * up
    if np.linalg.norm(away) < 1e-3:  # camera directly above
        away = np.array([0.0, -1.0, 0.0]) + up[1] * up
    away /= np.linalg.norm(away)
    right = np.cross(away, up)
    # Columns: x, y and z axes of the mesh in the camera's frame.
    if axis == 2:
        columns = [right, away, up]
    elif axis == 1:
        columns = [right, up, -away]
    else:
        columns = [up, away, -right]
    return np.stack(columns, axis=1)


def _depth_near(depth: NDArray[np.floating] | None, uv: tuple[float, float]) -> float | None:
    """Return the median sensor depth around a pixel, metres; None if there is none."""
    if depth is None:
        return None
    u, v = (round(x) for x in uv)
    part = depth[
        max(v - _REACH_PX, 0) : v + _REACH_PX + 1, max(u - _REACH_PX, 0) : u + _REACH_PX + 1
    ]
    measured = part[part > 0]
    return float(np.median(measured)) if len(measured) >= 5 else None


def up_axis(own: int | None, *others: Iterable[int | None]) -> int:
    """Return the coordinate axis (0, 1, 2) of a mesh that is up when it is shown or placed.

    Args:
        own: rotation axis of its shape; None if unknown.
        others: groups of up axes of related meshes; the first group with a known axis is used.
            Default: z.
    """
    if own is not None:
        return own
    for group in others:
        axes = [axis for axis in group if axis is not None]
        if axes:
            return max(sorted(set(axes)), key=axes.count)
    return 2


def standing_axis(session: Queries, model: Model) -> int:
    """Return the coordinate axis of a model that is up when it is shown alone.

    It is the axis used when the model is placed first.

    Raises:
        ToolkitError: its mesh cannot be read.
    """
    own = session.meshes.round_axis(model)
    return up_axis(own, () if own is not None else library_axes(session))


def library_axes(session: Queries) -> list[int]:
    """Return the rotation axes of the round meshes in the library of a session or snapshot.

    The meshes of one data set have the same up axis, so these also apply to boxes. Reads every mesh
    that is not cached.
    """
    axes = []
    for model in session.state.models:
        try:
            axis = session.meshes.round_axis(model)
        except ToolkitError:  # reported where the mesh itself is used
            continue
        if axis is not None:
            axes.append(axis)
    return axes


def drop_model(c: Controller, model_id: str, frame: int, uv: tuple[float, float]) -> bool:
    """Place an object of a library mesh dropped onto an image, as one edit.

    Places the selected object if it has this mesh and no pose, otherwise any such object, otherwise
    a new one.

    Args:
        model_id: id of a model of the scene, or name of a mesh of the folder, which is added first.
        frame: frame of the image.
        uv: pixel of the recorded image.
    """
    mesh = next((m for m in meshes_to_add(c.mesh_folder, c.session) if m.name == model_id), None)
    if mesh is not None:
        c.mesh_to_place = MeshToPlace(mesh, lambda added: drop_model(c, added, frame, uv))
        c.ask("place_mesh")
        return True
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
    """Place an object of the list dropped onto an image; a posed object keeps its rotation."""

    def place() -> None:
        known = c.session.pose(name, frame)
        model_id = c.session.object(name).model
        pose = _landing(c, model_id, frame, uv, R_cam_obj=None if known is None else known.R)
        if c.apply(SetPoses.one(name, frame, pose, method="drop")):
            c.select(name)

    return c.attempt(place)


def add_object(c: Controller, model_id: str) -> bool:
    """Place an object of a library mesh in the centre of the main view."""
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
    """Return the initial rotation of a mesh.

    The rotation of another object of the same mesh; otherwise upright according to its shape, to
    the objects of other meshes, to the round meshes of the library, or with z up.
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
    """Return the table in the coordinates of a frame's camera, or None if unknown."""
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
    """Return (3, 3) mesh axes to eye axes (x right, y down, z forward) of an upright mesh.

    Args:
        axis: the coordinate axis of the mesh (0, 1, 2) that is up.
    """
    azimuth, elevation = np.deg2rad([AZIMUTH_DEG, ELEVATION_DEG])
    up = np.array([0.0, -np.cos(elevation), -np.sin(elevation)])
    rotation: Array = so3_exp(-azimuth * up) @ upright_rotation(up, axis)
    return rotation
