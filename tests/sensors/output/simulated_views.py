"""Simulated scenes without a simulator: exact maps by ray casting, noise for pictures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh

from sensors.output.simulated_frame import SimulatedFrame, SimulatedObject, SimulatedScene
from sensors.synthetic.shapes import default_shapes
from sensors.viewpoints.camera_path import TrajectoryOptions, smooth_trajectory
from sensors.viewpoints.views import ViewpointOptions, random_viewpoints
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.geometry.mesh import nocs_frame
from std_toolkit.rendering.maps import render_scene_maps
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import PlacedMesh
from std_toolkit.scene.model import CATEGORY_CLASS_IDS

# Not the focal length nor the middle that loaders assume.
COLOR = Camera(640, 360, 459.0, 458.5, 321.3, 178.2)
INFRARED = Camera(320, 180, 231.0, 231.0, 159.1, 90.4)
LABELS = (320, 180)
T_IR_COLOR = SE3(so3_exp([0.002, -0.003, 0.001]), np.array([0.015, 0.0002, -0.0003]))
UPRIGHT = so3_exp([np.pi / 2, 0, 0])
PLACES = [(-0.16, -0.09), (0.02, -0.15), (0.17, -0.06), (-0.12, 0.13), (0.03, 0.04), (0.18, 0.14)]


def canonical(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, float]:
    """The mesh with a centred bounding box of unit diagonal, and the diagonal it had."""
    centre, diagonal = nocs_frame(mesh)
    vertices = (np.asarray(mesh.vertices) - centre) / diagonal
    return trimesh.Trimesh(vertices, mesh.faces, process=False), diagonal


def make_objects() -> list[SimulatedObject]:
    """Six upright objects apart from each other on the floor, turned about."""
    objects = []
    for i, (shape, place) in enumerate(zip(default_shapes(), PLACES, strict=True), start=1):
        mesh, diagonal = canonical(shape.mesh)
        turn = so3_exp([0, 0, 0.9 * i])
        height = shape.mesh.extents[1] / 2
        objects.append(
            SimulatedObject(
                instance_id=i,
                asset_id=f"{shape.name}-a{i}",
                category=shape.category,
                class_id=CATEGORY_CLASS_IDS.get(shape.category, 0),
                material_class=shape.material,
                scale_m=diagonal,
                T_world_obj=SE3(turn @ UPRIGHT, np.array([*place, height])),
                mesh=mesh,
                symmetry=shape.symmetry,
            )
        )
    return objects


def make_scene(*, name: str = "00017", frames: int = 3, seed: int = 17) -> SimulatedScene:
    return SimulatedScene(
        name=name,
        seed=seed,
        sensor="d415",
        frames=frames,
        objects=make_objects(),
        parameters={"floor": {"material": "wood"}, "light": 0.5, "samples": [16, 32]},
    )


def view_maps(scene: SimulatedScene, camera: Camera, T_world_cam: SE3):
    """Exact depth (floor included), mask, NOCS and normals in a camera."""
    T_cam_world = T_world_cam.inverse()
    placed = [
        PlacedMesh(
            o.instance_id,
            trimesh.Trimesh(o.mesh.vertices * o.scale_m, o.mesh.faces, process=False),
            T_cam_world @ o.T_world_obj,
        )
        for o in scene.objects
    ]
    maps = render_scene_maps(RaycastRenderer(), camera, placed)
    down = (camera.rays() @ T_world_cam.R.T)[..., 2]
    floor = np.where(down < -1e-3, -T_world_cam.t[2] / np.minimum(down, -1e-3), 0)
    depth = np.where(maps.mask > 0, maps.depth, floor).astype(np.float32)
    up = (T_cam_world.R @ [0, 0, 1.0]) * (floor > 0)[..., None]
    normals = np.where(maps.mask[..., None] > 0, maps.normals, up).astype(np.float32)
    return depth, maps.mask, maps.nocs, normals


def make_frame(
    scene: SimulatedScene,
    index: int,
    T_world_cam: SE3,
    *,
    labels: tuple[int, int] = LABELS,
    color: np.ndarray | None = None,
) -> SimulatedFrame:
    """A frame whose sensor depth has noise, a scale error and holes on the left border."""
    rng = np.random.default_rng([scene.seed, index])
    camera = COLOR if labels == COLOR.size else COLOR.resized(*labels)
    depth, mask, nocs, normals = view_maps(scene, camera, T_world_cam)
    T_world_ir = T_world_cam @ T_IR_COLOR.inverse()
    depth_ir, mask_ir, _, _ = view_maps(scene, INFRARED, T_world_ir)

    def measured(exact: np.ndarray) -> np.ndarray:
        noisy = exact * 1.01 + rng.normal(0, 0.001, exact.shape) * (exact > 0)
        noisy[:, :9] = 0
        return np.maximum(noisy, 0).astype(np.float32)

    def picture(size: Camera) -> np.ndarray:
        return rng.integers(0, 256, (size.height, size.width), dtype=np.uint8)

    if color is None:
        color = rng.integers(0, 256, (COLOR.height, COLOR.width, 3), dtype=np.uint8)
    return SimulatedFrame(
        index=index,
        color=color,
        infrared_left=picture(INFRARED),
        infrared_right=picture(INFRARED),
        depth_sensor=measured(depth_ir),
        depth_exact_infrared=depth_ir,
        mask_infrared=mask_ir,
        depth_aligned=measured(depth),
        depth_exact=depth,
        mask=mask,
        nocs=nocs,
        normals=normals,
        T_world_cam=T_world_cam,
        T_world_ir=T_world_ir,
        color_camera=COLOR,
        infrared_camera=INFRARED,
    )


def random_frames(scene: SimulatedScene) -> Iterator[SimulatedFrame]:
    """Frames from DREDS's viewpoints."""
    options = ViewpointOptions(count=scene.frames)
    for i, view in enumerate(random_viewpoints(scene.seed, options)):
        yield make_frame(scene, i, view.T_world_cam)


def followed_frames(scene: SimulatedScene) -> Iterator[SimulatedFrame]:
    """Frames of a smooth arc with pictures that show the objects, labels of colour's size."""
    from sensors.synthetic.camera_frames import render_frame
    from sensors.synthetic.raycast_world import World

    world = World(default_shapes(), [o.T_world_obj for o in scene.objects], seed=scene.seed)
    options = TrajectoryOptions(frames=scene.frames, sweep_deg=60, distance_m=(0.6, 0.7))
    for i, T_world_cam in enumerate(smooth_trajectory(scene.seed, options)):
        rng = np.random.default_rng([scene.seed, i])
        color = render_frame(world, COLOR, T_world_cam, rng=rng).color
        yield make_frame(scene, i, T_world_cam, labels=COLOR.size, color=color)
