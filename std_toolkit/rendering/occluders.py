"""Geometry of the unlabelled part of a scene, fused from the sensor depth of many frames.

Occluders of a labelled object must not come from depth measured on that object, because sensors
report false surfaces in front of glass and metal. Depth inside the outline of a transparent or
specular object is left out; inside the outline of another object, only depth well in front of the
object is kept. The remaining depth is fused in a truncated signed distance volume, which averages
noise over many views. Surfaces closer than `clearance` to a labelled object are removed, including
the table below it: with a depth bias of a few millimetres, the table would otherwise hide the
bottom of the object. Small loose pieces are removed.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from std_toolkit.geometry.camera import Camera, undistort_image
from std_toolkit.geometry.depth_maps import on_depth_step
from std_toolkit.geometry.ray_caster import RayCaster, import_open3d
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.documents import digest_file, digest_of
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.log import logger
from std_toolkit.options import FusionOptions
from std_toolkit.rendering import maps, placements, raycast
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh
from std_toolkit.rendering.renderer import PlacedMesh
from std_toolkit.scene.model import DIFFUSE_MATERIALS
from std_toolkit.scene.scene import Scene

OCCLUDER_FILE = "gt/occluders.ply"
_STEP = "render-occluders"
_MOST_FRAMES = 48
_TRUNCATION_VOXELS = 4.0
_HALF_PIXEL = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
_OUTLINE_MARGIN_PX = 7
_SMALLEST_PIECE_M2 = 4e-4
_OPEN3D_STRIDE = 4  # Open3D looks for voxels along the rays of every fourth pixel


def fuse_occluders(scene: Scene, options: FusionOptions) -> tuple[str, str]:
    """Write `gt/occluders.ply` (world frame, metres) unless it is up to date.

    Returns:
        The path of the file, and the digest of its content.
    """
    frames = _spread_frames(scene)
    views = [
        [
            f,
            digest_file(scene.root / str(scene.frame(f).depth)),
            _numbers(scene.T_world_cam(f)),
            [[o, _numbers(T)] for o, T in placements.frame_placements(scene, f).items()],
            repr(scene.camera(scene.frame(f))),
        ]
        for f in frames
    ]
    objects = [
        [o.id, o.material, digest_file(scene.mesh_path(scene.objects.model_of(o.id)))]
        for o in scene.objects.objects
    ]
    inputs = {
        "frames": digest_of(views, [scene.info.depth_scale, scene.info.depth_correction]),
        "objects": digest_of(objects),
    }
    values = {"voxel_m": options.voxel_m, "clearance_m": options.clearance_m}
    artefact = Artefact(scene.root, _STEP, inputs, values)
    path = scene.root / OCCLUDER_FILE
    if not artefact.is_kept():
        logger.info("fusing sensor depth of %d frames into occluding geometry", len(frames))
        vertices, faces = _fuse(scene, frames, options)
        _write_ply(path, vertices, faces)
        artefact.write([path])
    return str(path), digest_file(path)


@lru_cache(maxsize=2)
def load_occluder(path: str, digest: str) -> RenderMesh | None:  # noqa: ARG001 - cache key
    """Read the fused geometry; None if it is empty."""
    import trimesh

    loaded: Any = trimesh.load(path, process=False)
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        return None
    return prepare_mesh(loaded)


def _spread_frames(scene: Scene) -> list[int]:
    usable = [f.id for f in scene.registered_frames() if f.depth is not None]
    count = min(_MOST_FRAMES, len(usable))
    return [usable[i] for i in np.linspace(0, len(usable) - 1, count).round().astype(int)]


def _fuse(
    scene: Scene, frames: Sequence[int], options: FusionOptions
) -> tuple[np.ndarray, np.ndarray]:
    o3d = import_open3d()

    core = o3d.core
    channels: Any = (1, 1)
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight"),
        attr_dtypes=(core.float32, core.float32),
        attr_channels=channels,
        voxel_size=options.voxel_m,
        block_resolution=16,
        block_count=4000,
    )
    renderer = raycast.RaycastRenderer(threads=0)
    fused = 0
    for frame_id in frames:
        frame = scene.frame(frame_id)
        camera = scene.camera(frame)
        sensor = scene.read_depth(frame)
        T_world_cam = scene.T_world_cam(frame_id)
        if sensor is None or T_world_cam is None:
            continue
        if camera.is_distorted:
            sensor = _undistorted(sensor, camera)
            camera = camera.without_distortion()
        placed = placements.place_meshes(scene, placements.frame_placements(scene, frame_id))
        depth, farthest = _trusted_depth(scene, sensor, camera, placed, renderer, options)
        sampled = depth[::_OPEN3D_STRIDE, ::_OPEN3D_STRIDE]
        if not ((sampled > 0) & (sampled < farthest)).any():
            continue  # Open3D refuses a view without a voxel
        fused += 1
        reading = o3d.t.geometry.Image(
            core.Tensor.from_numpy(np.ascontiguousarray(depth, np.float32))
        )
        # Open3D rounds projections down here, which assumes pixel centres at 0.5.
        K = core.Tensor.from_numpy(camera.K + _HALF_PIXEL)
        pose = core.Tensor.from_numpy(T_world_cam.inverse().matrix())
        view = (reading, K, pose, 1.0, farthest, _TRUNCATION_VOXELS)
        grid.integrate(grid.compute_unique_block_coordinates(*view), *view)
    if not fused:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    mesh = grid.extract_triangle_mesh(weight_threshold=min(3.0, len(frames) / 4))
    if len(mesh.vertex) == 0 or len(mesh.triangle) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    vertices, faces = _in_order(
        mesh.vertex.positions.numpy().astype(np.float64), mesh.triangle.indices.numpy()
    )
    return _cut(scene, vertices, faces, options)


def _in_order(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reorder a mesh so that the result does not depend on thread scheduling."""
    vertices, renumbered = np.unique(vertices, axis=0, return_inverse=True)
    faces = renumbered.reshape(-1)[faces]
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return vertices, np.unique(faces, axis=0)


def _undistorted(depth: np.ndarray, camera: Camera) -> np.ndarray:
    return undistort_image(depth, camera, interpolation=cv2.INTER_NEAREST).astype(np.float32)


def _trusted_depth(
    scene: Scene,
    sensor: np.ndarray,
    camera: Camera,
    placed: Sequence[PlacedMesh],
    renderer: raycast.RaycastRenderer,
    options: FusionOptions,
) -> tuple[np.ndarray, float]:
    """Depth that may show occluders, and the depth beyond which nothing can hide an object."""
    depth = np.where(on_depth_step(sensor), np.float32(0), sensor)
    if not placed:
        return depth, 3.0
    kernel = np.ones((2 * _OUTLINE_MARGIN_PX + 1,) * 2, np.uint8)
    composition = maps.compose(renderer, camera, placed)
    farthest = 0.0
    for item, silhouette in zip(placed, composition.silhouettes, strict=True):
        mesh, T = item.prepared, item.T_cam_obj
        farthest = max(farthest, float((mesh.hull @ T.R.T + T.R @ mesh.centre + T.t)[:, 2].max()))
        outline = silhouette.image_mask(camera)
        grown = cv2.dilate(outline.view(np.uint8), kernel) > 0
        if scene.objects.object(item.object_id).material in DIFFUSE_MATERIALS:
            nearest = float((mesh.hull @ T.R.T + T.R @ mesh.centre + T.t)[:, 2].min())
            grown &= depth > nearest - options.clearance_m
        depth[grown] = 0
    return depth, max(farthest, 0.1)


def _cut(
    scene: Scene, vertices: np.ndarray, faces: np.ndarray, options: FusionOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Remove geometry near or inside labelled objects, then small pieces."""
    o3d = import_open3d()

    if len(faces) == 0:
        return vertices, faces
    near = np.zeros(len(vertices), bool)
    for row in scene.objects.objects:
        T_world_obj = scene.T_world_obj(row.id)
        if T_world_obj is None:
            continue
        mesh = prepare_mesh(scene.mesh(row.model))
        local = T_world_obj.inverse() @ vertices - mesh.centre
        reach = np.abs(mesh.vertices).max(axis=0) + options.clearance_m
        box = np.flatnonzero((np.abs(local) <= reach).all(axis=1))
        if len(box) == 0:
            continue
        caster = RayCaster(mesh.vertices, mesh.faces)
        near[box] |= caster.distance(local[box]) < options.clearance_m
        near[box] |= caster.inside(local[box])
    faces = faces[~near[faces].any(axis=1)]
    if len(faces) == 0:
        return vertices[:0], faces
    mesh_left = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces)
    )
    piece, _, area = mesh_left.cluster_connected_triangles()
    faces = faces[np.asarray(area)[np.asarray(piece)] >= _SMALLEST_PIECE_M2]
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3)


def _write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a binary PLY without a library, whose header might contain its version."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    table = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", (3,))]))
    table["count"], table["corners"] = 3, faces
    with atomic_path(path) as temporary:
        temporary.write_bytes(header.encode() + vertices.astype("<f4").tobytes() + table.tobytes())


def _numbers(T: SE3 | None) -> list[float] | None:
    return None if T is None else T.matrix().ravel().tolist()
