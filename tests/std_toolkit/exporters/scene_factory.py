"""Small scenes with everything in them, made without any camera or reconstruction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.geometry.mesh import mesh_diameter, mesh_extents
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.jobs import JobOptions
from std_toolkit.options import RenderOptions
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    LabelProvenance,
    Labels,
    Model,
    Object,
    ObjectTable,
    Scene,
    SceneInfo,
    SymmetryModel,
)
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, ContinuousSymmetry, ScaleReport

SERIAL = JobOptions(engine="serial", progress=False)


def box_mesh() -> trimesh.Trimesh:
    """A brick whose origin is one of its corners, with vertex colours."""
    mesh = trimesh.creation.box(extents=(0.06, 0.09, 0.13))
    mesh.apply_translation((0.03, 0.045, 0.065))
    colors = np.linspace(0, 255, len(mesh.vertices) * 4).reshape(-1, 4).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
    return mesh


def can_mesh() -> trimesh.Trimesh:
    """A can, axis z, its origin below its middle."""
    mesh = trimesh.creation.cylinder(radius=0.03, height=0.1, sections=40)
    mesh.apply_translation((0, 0, 0.02))
    return mesh


def mug_mesh() -> trimesh.Trimesh:
    """Something without any symmetry."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    v = np.array(mesh.vertices)
    v[:, 0] += 0.5 * np.maximum(v[:, 1], 0) + 8 * np.maximum(v[:, 2], 0) ** 2
    mesh.vertices = v
    return mesh


MESHES = {"brick": box_mesh, "can": can_mesh, "mug": mug_mesh}
CATEGORIES = {"brick": "other", "can": "can", "mug": "mug"}
SYMMETRIES = {
    # A half turn about the brick's own vertical middle line.
    "brick": SymmetryModel(discrete=[[-1, 0, 0, 0.06, 0, -1, 0, 0.09, 0, 0, 1, 0, 0, 0, 0, 1.0]]),
    "can": SymmetryModel(continuous=[ContinuousSymmetry(axis=[0, 0, 1], offset=[0, 0, 0.02])]),
    "mug": SymmetryModel(),
}
WORLD_POSES = {
    1: SE3(so3_exp([0.2, 0.1, 0.3]), np.array([-0.12, -0.05, 0.65])),
    4: SE3(so3_exp([1.4, -0.2, 0.1]), np.array([0.03, 0.02, 0.6])),
    7: SE3(so3_exp([0.3, 1.2, -0.5]), np.array([0.12, -0.02, 0.72])),
}
# Number 9 is for scenes with two bricks.
MODELS_OF = {1: "brick", 4: "can", 7: "mug", 9: "brick"}
NAMES = {1: "the_brick", 4: "the_can", 7: "the_mug", 9: "another_brick"}
MATERIALS = {1: "diffuse", 4: "transparent", 7: "specular", 9: "diffuse"}


def make_scene(
    root: Path,
    *,
    size: tuple[int, int] = (160, 120),
    frames: int = 3,
    distortion: tuple[float, ...] = (),
    world_poses: dict[int, SE3] | None = None,
    depth: bool = True,
    near_strip: bool = False,
    policy: str = "models",
    camera_poses: Sequence[SE3] | None = None,
    depth_correction: float = 1.0,
    unregistered: Sequence[int] = (),
    render: bool = True,
) -> Scene:
    """A scene of three objects (ids 1, 4, 7) with frames named `view_N` and ids 0, 2, 4, ..."""
    world_poses = WORLD_POSES if world_poses is None else world_poses
    width, height = size
    camera = Camera(
        width, height, 1.1 * width, 1.12 * width, width / 2 + 2.3, height / 2 - 1.6, distortion
    )
    if camera_poses is None:
        camera_poses = [
            SE3(so3_exp([0.02 * i, 0.08 * i, 0.03 * i]), np.array([-0.05 * i, 0.01 * i, 0.01 * i]))
            for i in range(frames)
        ]
    rng = np.random.default_rng(7)
    rows = []
    for i in range(len(camera_poses)):
        frame_id = 2 * i
        color = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
        write_color(root / f"color/view_{i}.png", color)
        if depth:
            z = np.full((height, width), 0.9, np.float32) + rng.normal(0, 0.002, (height, width))
            z[: height // 8] = 0
            if near_strip:
                # Something unlabelled in front of whatever lies in the right third.
                z[:, 2 * width // 3 :] = 0.4
            write_depth_png16(root / f"depth/view_{i}.png", z, scale=0.00025)
        rows.append(
            Frame(
                id=frame_id,
                name=f"view_{i}",
                color=f"color/view_{i}.png",
                depth=f"depth/view_{i}.png" if depth else None,
                timestamp=12.5 + i / 30,
            )
        )
    used = sorted({MODELS_OF[i] for i in world_poses})
    models = []
    for name in used:
        mesh = MESHES[name]()
        path = root / f"models/{name}/{name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        mesh.export(path)
        models.append(
            Model(
                id=name,
                mesh=f"models/{name}/{name}.ply",
                category=CATEGORIES[name],
                class_id=CATEGORY_CLASS_IDS[CATEGORIES[name]],
                size_m=[float(x) for x in mesh_extents(mesh)],
                diameter_m=mesh_diameter(mesh),
                symmetry=SYMMETRIES[name],
            )
        )
    scene = Scene.create(
        root,
        SceneInfo(
            name="bench_7",
            cameras={"color": CameraModel.of(camera)},
            depth_scale=0.00025 if depth else None,
            depth_correction=depth_correction,
            source="test",
        ),
        Frames(frames=rows),
        ObjectTable(
            models=models,
            objects=[
                Object(id=i, name=NAMES[i], model=MODELS_OF[i], material=MATERIALS[i])
                for i in sorted(world_poses)
            ],
        ),
    )
    scene.save_poses(
        CameraPoses(
            frames=[
                FramePose(frame=2 * i, status="unregistered")
                if i in unregistered
                else FramePose(
                    frame=2 * i,
                    status="registered",
                    T_world_cam=T.flat(),
                    points=50,
                    reprojection_px=0.4,
                )
                for i, T in enumerate(camera_poses)
            ],
            scale=ScaleReport(unit="metre", chosen="board"),
        )
    )
    first = next(i for i in range(len(camera_poses)) if i not in unregistered)
    T_cam_world = camera_poses[first].inverse()
    scene.save_labels(
        Labels(
            labels=[
                Label(
                    object=i,
                    frame=2 * first,
                    T_cam_obj=(T_cam_world @ T).flat(),
                    T_world_obj=T.flat(),
                    refined=True,
                    annotator="tester",
                    provenance=LabelProvenance(
                        time="2025-03-07T14:02:31Z", tool="std-annotate", version="0.1.0"
                    ),
                )
                for i, T in sorted(world_poses.items())
            ]
        )
    )
    if render:
        report = render_ground_truth(
            scene, RenderOptions(renderer="raycast", policy=policy), jobs=SERIAL
        )
        report.raise_if_failed()
    return scene
