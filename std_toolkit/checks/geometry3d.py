"""Geometry for the report's 3D view: few enough points and triangles for a web page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.caster import mesh_problem
from std_toolkit.labels.support.cloud import fuse_clouds, sparse_points
from std_toolkit.scene import Frame, Scene

MOST_POINTS = 12000
MOST_FACES = 900
FUSED_FRAMES = 5
VOXEL_M = 0.006


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of the world: xyz (N, 3) metres, rgb (N, 3) uint8."""

    xyz: NDArray[np.float32]
    rgb: NDArray[np.uint8]


def sparse_cloud(scene: Scene) -> Cloud | None:
    """The points of the reconstruction (poses/points.ply); None if there are none."""
    found = sparse_points(scene)
    return None if found is None else _thinned(*found)


def fused_cloud(scene: Scene, frames: list[Frame]) -> Cloud | None:
    """Sensor depth of some spread frames in the world; None without depth or metres."""
    usable = [f for f in frames if f.depth is not None and scene.T_world_cam(f.id) is not None]
    # Depth is in metres: it cannot be put into a world of unknown unit.
    scale = None if scene.poses is None else scene.poses.scale
    if not usable or (scale is not None and scale.unit != "metre"):
        return None
    chosen = np.unique(np.linspace(0, len(usable) - 1, FUSED_FRAMES).round().astype(int))
    cloud = fuse_clouds(scene, [usable[i] for i in chosen], voxel_m=VOXEL_M, limit=2 * MOST_POINTS)
    return _thinned(cloud.points, cloud.colors) if len(cloud.points) else None


def labelled_mesh(
    scene: Scene, object_id: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]] | None:
    """Vertices (V, 3) in the world and faces (F, 3) of an object, decimated.

    None without a label, or without a mesh that can be read.
    """
    T_world_obj = scene.T_world_obj(object_id)
    if T_world_obj is None or mesh_problem(scene, scene.objects.object(object_id).model):
        return None
    import open3d as o3d

    source = scene.mesh(scene.objects.object(object_id).model)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.asarray(source.vertices, dtype=np.float64)),
        o3d.utility.Vector3iVector(np.asarray(source.faces, dtype=np.int32)),
    )
    # Texture seams split vertices; decimation would tear the surface there.
    mesh.remove_duplicated_vertices()
    mesh.remove_degenerate_triangles()
    if len(mesh.triangles) > MOST_FACES:
        mesh = mesh.simplify_quadric_decimation(MOST_FACES)
    vertices = T_world_obj @ np.asarray(mesh.vertices)
    return vertices.astype(np.float32), np.asarray(mesh.triangles, dtype=np.int32)


def near_points(cloud: Cloud, centre: NDArray[np.floating], radius_m: float) -> Cloud:
    """The points within a radius, so that a far wall does not make the scene small."""
    near = np.linalg.norm(cloud.xyz - centre, axis=1) <= radius_m
    return Cloud(cloud.xyz[near], cloud.rgb[near])


def _thinned(xyz: NDArray[np.floating], rgb: NDArray[np.uint8]) -> Cloud:
    """At most `MOST_POINTS` points, far outliers left out, always the same ones."""
    middle = np.median(xyz, axis=0)
    distance = np.linalg.norm(xyz - middle, axis=1)
    near = distance <= 6 * max(float(np.median(distance)), 1e-6)
    xyz, rgb = xyz[near], rgb[near]
    if len(xyz) > MOST_POINTS:
        keep = np.sort(np.random.default_rng(0).choice(len(xyz), MOST_POINTS, replace=False))
        xyz, rgb = xyz[keep], rgb[keep]
    return Cloud(xyz.astype(np.float32), rgb)
