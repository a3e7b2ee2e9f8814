"""A small complete scene, written in milliseconds: for tests of the store and of faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

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

CAMERA = Camera(96, 72, 90.0, 90.0, 47.5, 35.5)
OBJECT_IN_WORLD = SE3.exp([0.0, 0.0, 0.6, 0.3, 0.2, 0.1])


def camera_pose(index: int) -> SE3:
    return SE3.exp([0.02 * index, 0.0, 0.0, 0.0, -0.03 * index, 0.0])


def write_scene(root: Path, *, frames: int = 3, labelled: bool = True) -> Scene:
    """A wall at 0.8 m, a box in front of it, poses and a propagated label."""
    rng = np.random.default_rng(0)
    table = []
    for i in range(frames):
        name = f"{i:06d}"
        write_color(root / f"color/{name}.png", rng.integers(0, 256, (72, 96, 3), dtype=np.uint8))
        write_depth_png16(root / f"depth/{name}.png", np.full((72, 96), 0.8), scale=0.001)
        table.append(Frame(id=i, name=name, color=f"color/{name}.png", depth=f"depth/{name}.png"))
    mesh = trimesh.creation.box((0.06, 0.04, 0.1))
    (root / "models/box").mkdir(parents=True)
    mesh.export(root / "models/box/box.ply")
    box = Model(id="box", mesh="models/box/box.ply", size_m=[0.06, 0.04, 0.1], diameter_m=0.1232883)
    scene = Scene.create(
        root,
        SceneInfo(name="tiny", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.001),
        Frames(frames=table),
        ObjectTable(
            models=[box], objects=[Object(id=1, name="box_1", model="box", material="diffuse")]
        ),
    )
    if labelled:
        poses = [
            FramePose(frame=i, status="registered", T_world_cam=camera_pose(i).flat())
            for i in range(frames)
        ]
        scene.save_poses(CameraPoses(frames=poses, source="import:test"))
        T_cam_obj = camera_pose(0).inverse() @ OBJECT_IN_WORLD
        label = Label(
            object=1, frame=0, T_cam_obj=T_cam_obj.flat(), T_world_obj=OBJECT_IN_WORLD.flat()
        )
        scene.save_labels(Labels(labels=[label]))
    return scene


def contents(root: Path) -> dict[str, bytes]:
    """Every file of a folder but the lock: what must not change."""
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        # A damaged scene may hold a link to an endless device.
        if path.is_file() and not path.is_symlink() and path.name != "lock"
    }
