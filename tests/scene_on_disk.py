"""Scenes written in milliseconds: a small complete one, and the parts that others are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

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
    SymmetryModel,
)
from std_toolkit.scene.pose_model import ScaleReport

CAMERA = Camera(96, 72, 90.0, 90.0, 47.5, 35.5)
OBJECT_IN_WORLD = SE3.exp([0.0, 0.0, 0.6, 0.3, 0.2, 0.1])


def camera_pose(index: int) -> SE3:
    return SE3.exp([0.02 * index, 0.0, 0.0, 0.0, -0.03 * index, 0.0])


def write_scene(root: Path, *, frames: int = 3, labelled: bool = True) -> Scene:
    """A wall at 0.8 m, a box in front of it, poses and a propagated label."""
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (72, 96, 3), dtype=np.uint8) for _ in range(frames)]
    table = write_frames(root, images, [np.full((72, 96), 0.8)] * frames)
    scene = Scene.create(
        root,
        SceneInfo(name="tiny", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.001),
        table,
        ObjectTable(
            models=write_models(root, {"box": trimesh.creation.box((0.06, 0.04, 0.1))}),
            objects=[Object(id=1, name="box_1", model="box", material="diffuse")],
        ),
    )
    if labelled:
        scene.save_poses(camera_poses([camera_pose(i) for i in range(frames)]))
        T_cam_obj = camera_pose(0).inverse() @ OBJECT_IN_WORLD
        label = Label(
            object=1, frame=0, T_cam_obj=T_cam_obj.flat(), T_world_obj=OBJECT_IN_WORLD.flat()
        )
        scene.save_labels(Labels(labels=[label]))
    return scene


def write_frames(
    root: Path,
    images: Sequence[NDArray[np.uint8]],
    depths: Sequence[NDArray[np.floating]] | None = None,
    *,
    depth_scale: float = 0.001,
) -> Frames:
    """Images (H, W, 3) and depth (H, W) in metres as frames 0, 1, ...; depth may be left out."""
    rows = []
    for i, image in enumerate(images):
        color, depth = f"color/{i:06d}.png", f"depth/{i:06d}.png"
        write_color(root / color, image)
        if depths is not None:
            write_depth_png16(root / depth, depths[i], scale=depth_scale)
        rows.append(
            Frame(id=i, name=f"{i:06d}", color=color, depth=None if depths is None else depth)
        )
    return Frames(frames=rows)


def write_models(
    root: Path,
    meshes: Mapping[str, trimesh.Trimesh],
    symmetries: Mapping[str, SymmetryModel] | None = None,
) -> list[Model]:
    """Meshes in metres by model id, as files of the scene and rows of objects.json."""
    models = []
    for name, mesh in sorted(meshes.items()):
        path = f"models/{name}/{name}.ply"
        (root / path).parent.mkdir(parents=True)
        mesh.export(root / path)
        models.append(
            Model(
                id=name,
                mesh=path,
                size_m=[float(x) for x in mesh.extents],
                diameter_m=float(np.linalg.norm(mesh.extents)),
                symmetry=(symmetries or {}).get(name, SymmetryModel()),
            )
        )
    return models


def camera_poses(
    T_world_cam: Sequence[SE3 | None], *, scale: ScaleReport | None = None
) -> CameraPoses:
    """poses.json of frames 0, 1, ...; None for those that are not registered."""
    rows = [
        FramePose(
            frame=i,
            status="unregistered" if T is None else "registered",
            T_world_cam=None if T is None else T.flat(),
        )
        for i, T in enumerate(T_world_cam)
    ]
    return CameraPoses(frames=rows, scale=scale, source="import:test")


def contents(root: Path) -> dict[str, bytes]:
    """Every file of a folder but the lock: what must not change."""
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        # A damaged scene may hold a link to an endless device.
        if path.is_file() and not path.is_symlink() and path.name != "lock"
    }
