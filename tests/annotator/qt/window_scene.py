"""A scene for the window: grey images, in which only what is drawn over them has a colour."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.scene import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    Scene,
    SceneInfo,
)

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
GREY = 90
# Upright before the cameras, and beside it a place for the other one.
T_WORLD_BOX = SE3.exp([0.0, 0.0, 0.6, 0.3, 0.2, 0.1])
BOX_SIZE = (0.10, 0.07, 0.14)


def camera_pose(index: int) -> SE3:
    """Cameras on an arc of 0.6 m around the box, 8 degrees from one to the next."""
    turn = SE3.exp([0.0, 0.0, 0.0, 0.0, -np.radians(8.0 * index), 0.0])
    middle = SE3(np.eye(3), np.array([0.0, 0.0, 0.6]))
    return middle @ turn @ middle.inverse()


def write_window_scene(
    root: Path, *, frames: int = 6, posed: bool = True, depth: bool = True, labelled: bool = True
) -> Path:
    """A light box before a grey wall at 0.9 m, and depth; the box is labelled, a ball is not."""
    table = []
    for i in range(frames):
        name = f"{i:06d}"
        image, distance = _seen(camera_pose(i).inverse() @ T_WORLD_BOX)
        cv2.putText(image, f"{i}", (8, 30), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (200, 200, 200), 2)
        write_color(root / f"color/{name}.png", image)
        if depth:
            write_depth_png16(root / f"depth/{name}.png", distance, scale=0.001)
        table.append(
            Frame(
                id=i,
                name=name,
                color=f"color/{name}.png",
                depth=f"depth/{name}.png" if depth else None,
            )
        )
    scene = Scene.create(
        root,
        SceneInfo(name="bench", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.001),
        Frames(frames=table),
        ObjectTable(
            models=[_model(root, "ball"), _model(root, "box")],
            objects=[
                Object(id=1, name="box_1", model="box", material="diffuse"),
                Object(id=2, name="ball_1", model="ball", material="transparent"),
            ],
        ),
    )
    if posed:
        poses = [
            FramePose(frame=i, status="registered", T_world_cam=camera_pose(i).flat())
            for i in range(frames)
        ]
        scene.save_poses(CameraPoses(frames=poses, source="import:test"))
    if labelled:
        T_cam_obj = camera_pose(0).inverse() @ T_WORLD_BOX
        scene.save_labels(Labels(labels=[Label(object=1, frame=0, T_cam_obj=T_cam_obj.flat())]))
    return root


def _seen(T_cam_box: SE3) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Image (H, W, 3) and depth (H, W) in metres: each face of the box in a grey of its own."""
    rays = CAMERA.rays()
    T_box_cam = T_cam_box.inverse()
    eye, directions = T_box_cam.t, rays @ T_box_cam.R.T
    half = np.array(BOX_SIZE) / 2
    with np.errstate(divide="ignore"):
        planes = (np.stack([-half, half])[:, None, None] - eye) / directions
    enter, leave = planes.min(axis=0), planes.max(axis=0)
    z = enter.max(axis=-1)
    hit = (z < leave.min(axis=-1)) & (z > 0)
    # The rays have z = 1, so that their multiple is the depth.
    distance = np.where(hit, z, 0.9)
    shades = np.array([150, 180, 210])[enter.argmax(axis=-1)]
    grey = np.where(hit, shades, GREY).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1), distance


def write_box(path: Path, *, scale: float = 1.0) -> Path:
    """A mesh file of a box of 60 x 40 x 20 mm times `scale`, in metres."""
    mesh = trimesh.creation.box((0.06 * scale, 0.04 * scale, 0.02 * scale))
    mesh.export(path)
    return path


def _model(root: Path, name: str) -> Model:
    mesh = trimesh.creation.box(BOX_SIZE) if name == "box" else trimesh.creation.icosphere(3, 0.035)
    path = root / "models" / name / f"{name}.ply"
    path.parent.mkdir(parents=True)
    mesh.export(path)
    size = [float(x) for x in mesh.extents]
    return Model(
        id=name,
        mesh=f"models/{name}/{name}.ply",
        size_m=size,
        diameter_m=float(np.linalg.norm(size)) if name == "box" else 0.07,
    )
