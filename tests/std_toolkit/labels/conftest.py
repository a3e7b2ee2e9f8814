"""A tiny scene on disk: three frames of noise, a box as the object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from tiny_camera import CAMERA, camera_pose

from std_toolkit.io.images import write_color
from std_toolkit.scene import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Scene,
    SceneInfo,
)


@pytest.fixture
def box_path(tmp_path: Path) -> Path:
    path = tmp_path / "input" / "box.obj"
    path.parent.mkdir()
    trimesh.creation.box((0.06, 0.04, 0.1)).export(path)
    return path


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    root = tmp_path / "scene"
    rng = np.random.default_rng(0)
    frames = []
    for i in range(3):
        image = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
        write_color(root / f"color/{i:06d}.png", image)
        frames.append(Frame(id=i, name=f"{i:06d}", color=f"color/{i:06d}.png"))
    scene = Scene.create(
        root,
        SceneInfo(name="tiny", cameras={"color": CameraModel.of(CAMERA)}),
        Frames(frames=frames),
    )
    scene.save_poses(
        CameraPoses(
            frames=[
                FramePose(frame=0, status="registered", T_world_cam=camera_pose(0.0).flat()),
                FramePose(frame=1, status="registered", T_world_cam=camera_pose(1.0).flat()),
                FramePose(frame=2, status="unregistered"),
            ]
        )
    )
    return scene
