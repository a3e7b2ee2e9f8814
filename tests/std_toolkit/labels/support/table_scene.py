"""A table with a box on it, seen from an arc: exact depth, exact poses, and what may go wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from scene_on_disk import camera_poses, write_frames, write_models

from sensors.synthetic.recording import look_at
from std_toolkit.geometry import SE3, Camera
from std_toolkit.rendering.maps import compose
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import PlacedMesh
from std_toolkit.scene import (
    CameraModel,
    Label,
    Labels,
    Object,
    ObjectTable,
    Scene,
    SceneInfo,
)
from std_toolkit.scene.pose_model import ScaleReport

CAMERA = Camera(320, 240, 300.0, 301.0, 158.0, 121.5)
BOX_SIZE = (0.08, 0.12, 0.1)
BOX = trimesh.creation.box(BOX_SIZE)
# A table that is level in no axis of the world.
T_WORLD_TABLE = SE3.exp([0.1, -0.2, 0.3, 0.4, -0.3, 0.7])
T_WORLD_BOX = T_WORLD_TABLE @ SE3(np.eye(3), np.array([0.05, 0.02, BOX_SIZE[2] / 2]))
TABLE_COLOR, BOX_COLOR = (150, 100, 50), (20, 60, 200)


def camera_pose(index: int, count: int) -> SE3:
    """T_world_cam on an arc at changing heights."""
    s = index / max(count - 1, 1)
    azimuth = np.radians(-50 + 100 * s)
    elevation = np.radians(45 + 12 * np.sin(7 * s))
    eye = 0.6 * np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return T_WORLD_TABLE @ look_at(eye, np.array([0.0, 0.0, 0.02]))


def write_table_scene(
    root: Path,
    *,
    frames: int = 8,
    depth: bool = True,
    factor: float = 1.0,
    noise_m: float = 0.0007,
    posed: bool = True,
    metres: bool = True,
    labelled: bool = True,
    sparse: int = 0,
) -> Scene:
    """Write the scene.

    Args:
        factor: the sensor reads this times the depth.
        sparse: number of reconstructed points on the table.
    """
    rng = np.random.default_rng(0)
    renderer = RaycastRenderer()
    ground = trimesh.Trimesh(
        [[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]], [[0, 1, 2], [0, 2, 3]]
    )
    images, depths = [], []
    for i in range(frames):
        T_cam_world = camera_pose(i, frames).inverse()
        placed = [
            PlacedMesh(1, ground, T_cam_world @ T_WORLD_TABLE),
            PlacedMesh(2, BOX, T_cam_world @ T_WORLD_BOX),
        ]
        seen = compose(renderer, CAMERA, placed)
        images.append(np.array([TABLE_COLOR, BOX_COLOR, (0, 0, 0)], np.uint8)[seen.index])
        if depth:
            noise = rng.normal(0, noise_m, seen.depth.shape) * (seen.depth > 0)
            depths.append(seen.depth * factor + noise)
    scene = Scene.create(
        root,
        SceneInfo(name="table", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.0001),
        write_frames(root, images, depths if depth else None, depth_scale=0.0001),
        ObjectTable(
            models=write_models(root, {"box": BOX}),
            objects=[Object(id=1, name="box", model="box", material="diffuse")],
        ),
    )
    if posed:
        scale = None if metres else ScaleReport(unit="unknown", chosen="none")
        T_world_cam = [camera_pose(i, frames) for i in range(frames)]
        scene.save_poses(camera_poses(T_world_cam, scale=scale))
    if labelled:
        T_cam_obj = camera_pose(0, frames).inverse() @ T_WORLD_BOX
        label = Label(
            object=1,
            frame=0,
            T_cam_obj=T_cam_obj.flat(),
            T_world_obj=T_WORLD_BOX.flat() if posed and metres else None,
        )
        scene.save_labels(Labels(labels=[label]))
    if sparse:
        write_sparse_points(root, rng.uniform(-0.35, 0.35, (sparse, 2)), rng)
    return scene


def write_sparse_points(root: Path, on_table: np.ndarray, rng: np.random.Generator) -> None:
    """poses/points.ply: points of the table with 1 mm of noise, a fifth of them anywhere."""
    local = np.concatenate([on_table, rng.normal(0, 0.001, (len(on_table), 1))], axis=1)
    stray = rng.random(len(local)) < 0.2
    local[stray, 2] = rng.uniform(0.0, 0.3, stray.sum())
    world = T_WORLD_TABLE @ local
    (root / "poses").mkdir(exist_ok=True)
    cloud = trimesh.PointCloud(world, colors=np.full((len(world), 4), 200, np.uint8))
    cloud.export(root / "poses/points.ply")
