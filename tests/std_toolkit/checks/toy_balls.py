"""Balls before a plain wall, drawn by formula: independent of the code under test."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3, so3_exp
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
from std_toolkit.scene.model import ContinuousSymmetry, SymmetryModel

CAMERA = Camera(320, 240, 330.0, 325.0, 163.3, 118.2)
RADIUS_M = 0.05
DISTANCE_M = 0.6
# Beside each other seen from everywhere on the arc.
CENTRES = {1: np.array([0.0, -0.07, 0.0]), 2: np.array([0.0, 0.07, 0.0])}
COLORS = {0: 110, 1: 200, 2: 40}


@dataclass(frozen=True)
class Toy:
    """What the toy scene may lack or get wrong.

    Attributes:
        frames: number of frames on the arc.
        arc_deg: angle of the arc about the balls.
        depth_error_m: added to the sensor depth; None leaves depth out.
        moved: object id to a displacement of its label in the world, metres.
        materials: of the two balls.
    """

    frames: int = 6
    arc_deg: float = 60.0
    depth_error_m: float | None = 0.0
    moved: dict[int, NDArray[np.float64]] | None = None
    materials: tuple[str, str] = ("diffuse", "diffuse")


def ball_mesh() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=5, radius=RADIUS_M)


def arc_pose(angle_deg: float) -> SE3:
    """A camera that looks at the origin; world y is up, the camera's y is down."""
    turn = so3_exp([0.0, np.deg2rad(angle_deg), 0.0])
    R = turn @ np.diag([1.0, -1.0, -1.0])
    return SE3(R, -DISTANCE_M * R[:, 2])


def draw_balls(
    camera: Camera, T_world_cam: SE3, *, samples: int = 6
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Colour (H, W, 3) with antialiased outlines, and z-depth (H, W) at pixel centres."""
    at = (np.arange(samples) + 0.5) / samples - 0.5
    grey = np.zeros((camera.height, camera.width))
    for dx in at:
        for dy in at:
            grey += _shade(camera, T_world_cam, dx, dy)[0] / samples**2
    depth = _shade(camera, T_world_cam, 0, 0)[1]
    return np.repeat(grey.round().astype(np.uint8)[..., None], 3, axis=2), depth


def _shade(
    camera: Camera, T_world_cam: SE3, dx: float, dy: float
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    rays = camera.unproject(camera.pixel_grid() + np.array([dx, dy]))
    grey = np.full(rays.shape[:2], float(COLORS[0]))
    # A wall 0.3 m behind the balls, square to the camera.
    depth = np.full(rays.shape[:2], DISTANCE_M + 0.3)
    for object_id, centre in CENTRES.items():
        c = T_world_cam.inverse() @ centre
        a, b = (rays**2).sum(axis=-1), rays @ c
        root = b**2 - a * (c @ c - RADIUS_M**2)
        z = (b - np.sqrt(np.maximum(root, 0))) / a
        hit = (root > 0) & (z < depth)
        grey[hit], depth[hit] = COLORS[object_id], z[hit]
    return grey, depth.astype(np.float32)


def write_toy(root: Path, toy: Toy) -> Scene:
    frames, poses = [], []
    angles = np.linspace(-toy.arc_deg / 2, toy.arc_deg / 2, toy.frames)
    for i, angle in enumerate(angles):
        T = arc_pose(float(angle))
        color, depth = draw_balls(CAMERA, T)
        write_color(root / f"color/{i:06d}.png", color)
        if toy.depth_error_m is not None:
            write_depth_png16(root / f"depth/{i:06d}.png", depth + toy.depth_error_m, scale=0.0001)
        frames.append(
            Frame(
                id=i,
                name=f"{i:06d}",
                color=f"color/{i:06d}.png",
                depth=f"depth/{i:06d}.png" if toy.depth_error_m is not None else None,
            )
        )
        poses.append(
            FramePose(
                frame=i,
                status="registered",
                T_world_cam=T.flat(),
                reprojection_px=0.5,
                points=100 + i,
            )
        )
    (root / "models/ball").mkdir(parents=True)
    ball_mesh().export(root / "models/ball/ball.ply")
    scene = Scene.create(
        root,
        SceneInfo(name="toy", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.0001),
        Frames(frames=frames),
        ObjectTable(
            models=[
                Model(
                    id="ball",
                    mesh="models/ball/ball.ply",
                    size_m=[2 * RADIUS_M] * 3,
                    diameter_m=2 * RADIUS_M,
                    symmetry=SymmetryModel(
                        continuous=[
                            ContinuousSymmetry(axis=[1, 0, 0]),
                            ContinuousSymmetry(axis=[0, 1, 0]),
                        ]
                    ),
                )
            ],
            objects=[
                Object(id=i, name=f"ball_{i}", model="ball", material=m)  # type: ignore[arg-type]
                for i, m in zip(CENTRES, toy.materials, strict=True)
            ],
        ),
    )
    scene.save_poses(CameraPoses(frames=poses, source="truth"))
    labels = []
    for i, centre in CENTRES.items():
        T_world_obj = SE3(np.eye(3), centre + (toy.moved or {}).get(i, np.zeros(3)))
        T_cam_world = arc_pose(float(angles[0])).inverse()
        labels.append(
            Label(
                object=i,
                frame=0,
                T_cam_obj=(T_cam_world @ T_world_obj).flat(),
                T_world_obj=T_world_obj.flat(),
            )
        )
    scene.save_labels(Labels(labels=labels))
    return scene
