"""Pictures of meshes on a table with sensor depth: noise, holes, and exact truth."""

from __future__ import annotations

import cv2
import numpy as np
import trimesh
from tiny_camera import camera_pose

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.labels.refine.caster import NONE, WorldCaster
from std_toolkit.labels.refine.problem import RefineObject, RefineView

CAMERA = Camera(320, 240, 330.0, 330.0, 161.0, 118.0)
_COLOURS = np.array(
    [[150, 140, 120], [200, 80, 60], [60, 90, 200], [70, 170, 80], [200, 190, 60]], float
)


def mesh_object(mesh: trimesh.Trimesh, pose: SE3, name: str = "thing", **arguments) -> RefineObject:
    return RefineObject(
        name, np.asarray(mesh.vertices, float), np.asarray(mesh.faces), pose, **arguments
    )


def table() -> RefineObject:
    """A table top at z = 0."""
    return mesh_object(
        trimesh.creation.box((1.2, 1.2, 0.02)), SE3(np.eye(3), np.array([0, 0, -0.01])), "table"
    )


def bottle_mesh() -> trimesh.Trimesh:
    """A bottle about z, its bottom at z = 0: shoulders, a neck, a handle on the +x side."""
    profile = [
        (0, 0),
        (0.03, 0),
        (0.032, 0.05),
        (0.03, 0.08),
        (0.013, 0.1),
        (0.013, 0.13),
        (0, 0.13),
    ]
    body = trimesh.creation.revolve(np.array(profile), sections=48)
    handle = trimesh.creation.box((0.02, 0.012, 0.05))
    handle.apply_translation((0.036, 0, 0.045))
    return trimesh.util.concatenate([body, handle])


def photograph(
    things: list[RefineObject],
    angle: float = 0.0,
    *,
    depth: bool = True,
    noise_m: float = 0.001,
    holes: float = 0.15,
    bias: float = 1.0,
    seed: int = 0,
) -> RefineView:
    """The things on the table; colour anti-aliased, depth with noise and blotches without any."""
    rng = np.random.default_rng([seed, round(1000 * (angle + 7))])
    pose = camera_pose(angle, radius=0.45, height=0.3)
    everything = [table(), *things]
    caster = WorldCaster(everything, [t.T_world_obj for t in everything])
    fine = CAMERA.resized(2 * CAMERA.width, 2 * CAMERA.height)
    hits = caster.cast(fine, pose, fine.pixel_grid())
    light = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    shade = 0.5 + 0.5 * np.abs(hits.normal @ light)
    index = np.where(hits.object == NONE, 0, hits.object % len(_COLOURS))
    image = _COLOURS[index] * shade[..., None]
    small = image.reshape(CAMERA.height, 2, CAMERA.width, 2, 3).mean(axis=(1, 3))
    color = np.clip(small + rng.normal(0, 2, small.shape), 0, 255).astype(np.uint8)
    if not depth:
        return RefineView.of(CAMERA, pose, color)
    exact = caster.cast(CAMERA, pose, CAMERA.pixel_grid()).depth
    sensor = bias * exact + rng.normal(0, noise_m, exact.shape)
    blotches = cv2.GaussianBlur(rng.normal(size=exact.shape), (0, 0), 4)
    missing = blotches < np.quantile(blotches, holes)
    sensor[missing | ~np.isfinite(exact)] = 0
    return RefineView.of(CAMERA, pose, color, sensor.astype(np.float32))


def off(T: SE3, centre: np.ndarray, shift_m: float, angle_deg: float, seed: int) -> SE3:
    """The pose moved and turned about the object's centre, in random directions."""
    rng = np.random.default_rng(seed)
    shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    R = so3_exp(axis * np.deg2rad(angle_deg)) @ T.R
    return SE3(R, T @ centre + shift_m * shift - R @ centre)
