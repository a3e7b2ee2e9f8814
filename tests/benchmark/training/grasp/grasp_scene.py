"""A small scene of known shapes, packed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from benchmark.methods.grasp.graspnet.cloud import GraspNetConfig
from benchmark.training.grasp.pack_grasps import begin_pack, write_scene
from benchmark.training.grasp.tabletop import TableObject, draw_cameras
from benchmark.training.options import GraspPackOptions
from std_toolkit.geometry.se3 import SE3, so3_exp

# Small enough for seconds; views as few as still have one near every direction.
TINY = GraspNetConfig(
    points=512,
    level_points=(192, 96, 32, 16),
    level_neighbours=(8, 8, 8, 8),
    width=16,
    views=60,
    angles=6,
    depths=(0.01, 0.03),
    cylinder_points=16,
    margin=0.03,
)
OPTIONS = GraspPackOptions(frames=2, size=(160, 90), points=1500, spacing=0.015)


def table_objects() -> list[TableObject]:
    """A box, a cylinder and a lower box, upright and apart."""
    shapes = (
        ("box", trimesh.creation.box((0.05, 0.06, 0.1)), 0.4, (-0.1, 0.02, 0.05)),
        ("cylinder", trimesh.creation.cylinder(0.03, 0.12, sections=32), 0.0, (0.08, -0.05, 0.06)),
        ("low", trimesh.creation.box((0.04, 0.09, 0.05)), -0.9, (0.05, 0.1, 0.025)),
    )
    return [
        TableObject(
            name,
            np.asarray(mesh.vertices),
            np.asarray(mesh.faces),
            SE3(so3_exp([0, 0, turn]), np.array(place)),
        )
        for name, mesh, turn, place in shapes
    ]


def pack_scene(folder: Path, options: GraspPackOptions = OPTIONS, scenes: int = 1) -> Path:
    """A pack of scenes that differ in where they are seen from."""
    folder.mkdir(parents=True, exist_ok=True)
    begin_pack(folder, options, TINY)
    for number in range(scenes):
        cameras = draw_cameras(options.seed + number, options.frames)
        write_scene(folder, number, table_objects(), cameras, options, TINY)
    return folder
