"""Copies of one small recording, labelled by several people: poses as a test wants them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh
from scene_on_disk import camera_poses, write_frames, write_models

from annotator.compare import Merge, MergeOptions, merge_labels
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.scene import (
    CameraModel,
    Label,
    Labels,
    Object,
    ObjectTable,
    Scene,
    SceneInfo,
    SymmetryModel,
)
from std_toolkit.scene.model import ContinuousSymmetry, ScaleReport

CAMERA = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
HALF_TURN_Z = [-1.0, 0, 0, 0, 0, -1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0]
SYMMETRIES = {
    "wedge": SymmetryModel(),
    "can": SymmetryModel(continuous=[ContinuousSymmetry(axis=[0.0, 0.0, 1.0])]),
    "tile": SymmetryModel(discrete=[HALF_TURN_Z]),
}
MESHES = {
    "wedge": trimesh.creation.box((0.08, 0.05, 0.10)),
    "can": trimesh.creation.cylinder(0.03, 0.12, sections=72),
    "tile": trimesh.creation.box((0.09, 0.06, 0.03)),
}
TRUE_POSES = {
    "wedge": SE3(so3_exp([0.3, 0.2, 0.1]), np.array([-0.12, 0.0, 0.7])),
    "can": SE3(so3_exp([1.2, 0.1, -0.3]), np.array([0.0, 0.02, 0.75])),
    "tile": SE3(so3_exp([0.9, -0.4, 0.2]), np.array([0.13, 0.0, 0.8])),
}


def camera_pose(index: int) -> SE3:
    """T_world_cam on an arc around the objects."""
    return SE3.exp([0.06 * index, 0.0, 0.004 * index**2, 0.0, -0.08 * index, 0.0])


def turned_about_centre(T: SE3, rotation_vector: list[float]) -> SE3:
    """The pose turned about the mesh origin, which is the centre here, by mesh-frame axes."""
    return SE3(T.R @ so3_exp(rotation_vector), T.t)


def write_annotator(
    root: Path,
    poses: Mapping[str, SE3] | None = None,
    *,
    frame: int = 0,
    frames: int = 5,
    posed: bool = True,
    unit: str = "metre",
    T_new_old: SE3 | None = None,
    propagated: bool = True,
    names: Mapping[str, str] | None = None,
    symmetries: Mapping[str, SymmetryModel] | None = None,
    annotator: str = "",
    seed: int = 0,
    views: Mapping[str, Mapping[int, SE3]] | None = None,
) -> Scene:
    """A scene of one annotator.

    Args:
        poses: T_world_obj by model id, in the common world; default: the true ones.
        frame: in which the objects were annotated.
        posed: the scene has camera poses, in `unit`.
        T_new_old: moves this annotator's world.
        names: object name by model id; default: the model's.
        seed: of the images.
        views: further annotations, T_cam_obj by frame by model id.
    """
    poses = TRUE_POSES if poses is None else poses
    move = T_new_old or SE3.identity()
    names = {**{m: m for m in MESHES}, **(names or {})}
    rng = np.random.default_rng(seed)
    size = (CAMERA.height, CAMERA.width, 3)
    images = [rng.integers(60, 110, size, dtype=np.uint8) for _ in range(frames)]
    scene = Scene.create(
        root,
        SceneInfo(name="table", cameras={"color": CameraModel.of(CAMERA)}),
        write_frames(root, images),
        ObjectTable(
            models=write_models(root, MESHES, symmetries or SYMMETRIES),
            objects=[
                Object(id=number, name=names[model], model=model, material="diffuse")
                for number, model in enumerate(MESHES, start=1)
            ],
        ),
    )
    if posed:
        scale = ScaleReport(unit=unit, chosen="test")  # type: ignore[arg-type]
        scene.save_poses(camera_poses([move @ camera_pose(i) for i in range(frames)], scale=scale))
    labels = []
    for number, model in enumerate(MESHES, start=1):
        if model not in poses:
            continue
        in_camera = camera_pose(frame).inverse() @ poses[model]
        world = (move @ poses[model]).flat() if posed and propagated else None
        more = {str(f): T.flat() for f, T in (views or {}).get(model, {}).items()}
        labels.append(
            Label(
                object=number,
                frame=frame,
                T_cam_obj=in_camera.flat(),
                T_world_obj=world,
                annotator=annotator,
                views=more,
            )
        )
    scene.save_labels(Labels(labels=labels))
    return Scene.open(root)


TIME = "2025-03-07T14:02:31Z"


def shifted(name: str, x_mm: float, y_mm: float = 0.0) -> SE3:
    T = TRUE_POSES[name]
    return SE3(T.R, T.t + np.array([x_mm, y_mm, 0.0]) / 1000)


def annotators(tmp_path: Path, *changes: dict[str, SE3]) -> list[Scene]:
    return [
        write_annotator(tmp_path / "ABCDE"[i], {**TRUE_POSES, **change}, annotator=f"p{i}")
        for i, change in enumerate(changes)
    ]


def merge(*scenes: Scene, target: Scene | None = None, **options: object) -> Merge:
    return merge_labels(scenes, MergeOptions(**options), target=target, time=TIME)  # type: ignore[arg-type]
