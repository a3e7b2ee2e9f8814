"""A scene whose poses and labels are the truth: for steps that are tested by themselves."""

from __future__ import annotations

import shutil
from pathlib import Path

from sensors.synthetic.recording import Truth, read_truth
from std_toolkit.geometry.mesh import load_mesh, mesh_diameter, mesh_extents
from std_toolkit.geometry.se3 import SE3
from std_toolkit.scene.model import (
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    SceneInfo,
)
from std_toolkit.scene.scene import Scene


def scene_from_truth(recording: Path, out: Path) -> Scene:
    """Write a scene with the recording's images, true camera poses and true labels."""
    truth = read_truth(recording)
    for folder in ("color", "depth"):
        shutil.copytree(recording / folder, out / folder)
    for item in truth.objects:
        target = out / "models" / item.name / Path(item.mesh).name
        target.parent.mkdir(parents=True)
        shutil.copyfile(recording / item.mesh, target)
    info = SceneInfo(
        name=recording.name,
        cameras={"color": truth.camera},
        depth_scale=truth.depth_scale,
        source="synthetic:truth",
    )
    frames = [
        Frame(id=i, name=name, color=f"color/{name}.png", depth=f"depth/{name}.png")
        for i, name in enumerate(truth.frames)
    ]
    scene = Scene.create(out, info, Frames(frames=frames), _objects(truth, recording))
    scene.save_poses(
        CameraPoses(
            frames=[
                FramePose(frame=i, status="registered", T_world_cam=T)
                for i, T in enumerate(truth.T_world_cam)
            ],
            source="truth",
        )
    )
    T_cam_world = truth.camera_pose(0).inverse()
    scene.save_labels(
        Labels(
            labels=[
                Label(
                    object=i,
                    frame=0,
                    T_cam_obj=(T_cam_world @ SE3.from_matrix(item.T_world_obj)).flat(),
                    T_world_obj=item.T_world_obj,
                    method="truth",
                )
                for i, item in enumerate(truth.objects, start=1)
            ]
        )
    )
    return scene


def _objects(truth: Truth, recording: Path) -> ObjectTable:
    models, objects = [], []
    for i, item in enumerate(truth.objects, start=1):
        mesh = load_mesh(recording / item.mesh)
        models.append(
            Model(
                id=item.name,
                mesh=f"models/{item.name}/{Path(item.mesh).name}",
                category=item.category,
                class_id=item.class_id,
                size_m=[float(x) for x in mesh_extents(mesh)],
                diameter_m=mesh_diameter(mesh),
                symmetry=item.symmetry,
            )
        )
        objects.append(Object(id=i, name=item.name, model=item.name, material=item.material))
    return ObjectTable(models=models, objects=objects)
