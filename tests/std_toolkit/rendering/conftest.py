"""A small scene of simple solids with exact poses, for rendering tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import mesh_diameter, mesh_extents
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.maps import render_scene_maps
from std_toolkit.rendering.renderer import RENDERERS, PlacedMesh, Renderer
from std_toolkit.scene.model import (
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
    SceneInfo,
)
from std_toolkit.scene.scene import Scene
from tests.skips import need_gl

CAMERA = Camera(320, 240, 300.0, 300.0, 161.3, 118.6)
TABLE_Z = 0.05


@pytest.fixture(params=RENDERERS.names())
def renderer(request: pytest.FixtureRequest) -> Renderer:
    """Every registered renderer by turns; pyrender only where GL works."""
    if request.param == "pyrender":
        need_gl()
    return get_renderer(request.param)


def look_at(eye: np.ndarray, target: np.ndarray) -> SE3:
    """`T_world_cam` of a camera at `eye` that looks at `target`, world z up."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return SE3(np.stack([right, np.cross(forward, right), forward], axis=1), eye)


def flat_box(extents: tuple[float, float, float], centre: tuple[float, float, float]) -> object:
    """A box in the world frame."""
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(centre)
    return mesh


@pytest.fixture
def make_scene(tmp_path: Path) -> Callable[..., Scene]:
    """Build a scene: a ball and a block on a table, a board in front that nobody labelled."""

    def build(
        *, frames: int = 3, depth: bool = True, board: bool = False, material: str = "diffuse"
    ) -> Scene:
        root = tmp_path / "scene"
        ball = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
        block = trimesh.creation.box((0.05, 0.08, 0.06))
        meshes = {"ball": ball, "block": block}
        models = []
        for name, mesh in meshes.items():
            path = root / "models" / name / "mesh.ply"
            path.parent.mkdir(parents=True)
            mesh.export(path)
            models.append(
                Model(
                    id=name,
                    mesh=f"models/{name}/mesh.ply",
                    size_m=mesh_extents(mesh).tolist(),
                    diameter_m=mesh_diameter(mesh),
                )
            )
        T_world = {
            1: SE3(np.eye(3), np.array([-0.05, 0.0, 0.04])),
            7: SE3.exp(np.array([0.06, 0.03, 0.03, 0.0, 0.0, 0.4])),
        }
        names = {1: "ball", 7: "block"}
        table = flat_box((1.2, 1.2, 0.02), (0, 0, -0.01))
        stranger = flat_box((0.03, 0.02, 0.12), (-0.05, -0.12, 0.06))
        color_dir, depth_dir = root / "color", root / "depth"
        color_dir.mkdir(parents=True)
        depth_dir.mkdir()
        rows, poses = [], []
        raycast = get_renderer("raycast")
        for i, angle in enumerate(np.linspace(-1.2, 1.2, frames) if frames > 1 else [0.0]):
            eye = 0.6 * np.array([np.sin(angle), -np.cos(angle), 0.7])
            T_world_cam = look_at(eye, np.array([0.0, 0.0, 0.03]))
            T_cam_world = T_world_cam.inverse()
            name = f"{i:06d}"
            write_color(color_dir / f"{name}.png", np.full((240, 320, 3), 90, np.uint8))
            if depth:
                everything = [
                    PlacedMesh(o, meshes[names[o]], T_cam_world @ T_world[o]) for o in T_world
                ]
                everything.append(PlacedMesh(20, table, T_cam_world))
                if board:
                    everything.append(PlacedMesh(21, stranger, T_cam_world))
                seen = render_scene_maps(raycast, CAMERA, everything)
                write_depth_png16(depth_dir / f"{name}.png", seen.depth, scale=0.0001)
            rows.append(
                Frame(
                    id=i,
                    name=name,
                    color=f"color/{name}.png",
                    depth=f"depth/{name}.png" if depth else None,
                )
            )
            poses.append(
                FramePose(
                    frame=i, status="registered", T_world_cam=T_world_cam.matrix().ravel().tolist()
                )
            )
        scene = Scene.create(
            root,
            SceneInfo(
                name="solids",
                cameras={"color": CameraModel.of(CAMERA)},
                depth_scale=0.0001 if depth else None,
            ),
            Frames(frames=rows),
            ObjectTable(
                models=models,
                objects=[
                    Object(id=o, name=f"{names[o]}-{o}", model=names[o], material=material)
                    for o in names
                ],
            ),
        )
        scene.save_poses(CameraPoses(frames=poses))
        T_cam_world = scene.T_world_cam(0).inverse()
        scene.save_labels(
            Labels(
                labels=[
                    Label(
                        object=o,
                        frame=0,
                        T_cam_obj=(T_cam_world @ T).matrix().ravel().tolist(),
                        T_world_obj=T.matrix().ravel().tolist(),
                    )
                    for o, T in T_world.items()
                ]
            )
        )
        return scene

    return build
