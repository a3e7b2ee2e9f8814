"""A scene with a box whose texture tells its sides, photographed from an arc of cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.io.images import write_color
from std_toolkit.rendering.texture import TexturedSurface
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

CAMERA = Camera(320, 240, 420.0, 420.0, 159.5, 119.5)
SIZE = np.array([0.12, 0.05, 0.18])
T_WORLD_BOX = SE3(so3_exp([1.4, 0.1, 0.2]), np.array([0.01, 0.0, 0.02]))
HALF_TURN = SE3(so3_exp([0, 0, np.pi]), np.zeros(3))
TURN = "turned by 180 deg about z"


def picture(seed: int) -> NDArray[np.uint8]:
    """Patches in many colours, (256, 384, 3)."""
    random = np.random.default_rng(seed)
    image = np.full((256, 384, 3), 220, np.uint8)
    for _ in range(150):
        x, y = random.integers(0, 380), random.integers(0, 250)
        w, h = random.integers(8, 40, 2)
        image[y : y + h, x : x + w] = random.integers(0, 255, 3)
    return image


def write_box(path: Path, *, seed: int = 1) -> trimesh.Trimesh:
    """A box in a file of its own; each side shows its own sixth of the picture."""
    corners, uv, faces = [], [], []
    for number in range(6):
        axis, side = divmod(number, 2)
        i, j = (m for m in range(3) if m != axis)
        start = len(corners)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            p = np.zeros(3)
            p[axis], p[i], p[j] = 2 * side - 1, a, b
            corners.append(p * SIZE / 2)
            uv.append([number % 3 / 3 + (a + 1) / 6, number // 3 / 2 + (b + 1) / 4])
        faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    mesh = trimesh.Trimesh(np.array(corners), np.array(faces), process=False)
    material = trimesh.visual.material.SimpleMaterial(image=Image.fromarray(picture(seed)))
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.array(uv), material=material)
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)
    return mesh


def camera_pose(k: int, count: int) -> SE3:
    R = so3_exp([0, np.linspace(-0.9, 0.9, count)[k], 0]) @ so3_exp([0.45, 0, 0])
    return SE3(R, R @ np.array([0, 0, -0.5]))


def write_textured_scene(
    root: Path, *, T_world_obj: SE3 = T_WORLD_BOX, frames: int = 5, suffix: str = ".png"
) -> Path:
    """The scene with the box labelled in frame 0 at `T_world_obj`; without depth.

    Args:
        suffix: format of the images.
    """
    surface = TexturedSurface.from_mesh(write_box(root / "models/box/box.obj"))
    assert surface is not None
    random = np.random.default_rng(0)
    for k in range(frames):
        image = random.normal(120, 4, (240, 320, 3))
        drawn = surface.draw(CAMERA, camera_pose(k, frames).inverse() @ T_WORLD_BOX)
        assert drawn is not None
        h, w = drawn.mask.shape
        image[drawn.y : drawn.y + h, drawn.x : drawn.x + w][drawn.mask] = drawn.color[drawn.mask]
        write_color(root / f"color/{k:06d}{suffix}", np.clip(image, 0, 255).astype(np.uint8))
    extents = [float(x) for x in SIZE]
    model = Model(
        id="box",
        mesh="models/box/box.obj",
        size_m=extents,
        diameter_m=float(np.linalg.norm(SIZE)),
    )
    scene = Scene.create(
        root,
        SceneInfo(name="textured", cameras={"color": CameraModel.of(CAMERA)}),
        Frames(
            frames=[
                Frame(id=k, name=f"{k:06d}", color=f"color/{k:06d}{suffix}") for k in range(frames)
            ]
        ),
        ObjectTable(
            models=[model], objects=[Object(id=1, name="box_1", model="box", material="diffuse")]
        ),
    )
    poses = [
        FramePose(frame=k, status="registered", T_world_cam=camera_pose(k, frames).flat())
        for k in range(frames)
    ]
    scene.save_poses(CameraPoses(frames=poses, source="import:test"))
    T_cam_obj = camera_pose(0, frames).inverse() @ T_world_obj
    scene.save_labels(Labels(labels=[Label(object=1, frame=0, T_cam_obj=T_cam_obj.flat())]))
    return root
