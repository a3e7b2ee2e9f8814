"""Scenes for the tests of settling, and what holds of every scene that settled."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from sensors.assets import Asset, canonical_frame
from sensors.assets.asset_source import draw_diagonal
from sensors.assets.procedural.shape_library import CATEGORIES, make
from sensors.physics import PhysicalObject, convex_parts, drift
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support import PlacedObject, find_penetrations

DEEPEST_M = 0.001


def simple_objects() -> list[PhysicalObject]:
    """Convex bodies and a ring, whose parts take no time."""
    upright = trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))
    meshes = {
        "box": trimesh.creation.box((0.06, 0.12, 0.16)),
        "tin": trimesh.creation.cylinder(0.03, 0.1, sections=48),
        "ball": trimesh.creation.icosphere(3, 0.05),
        "cone": trimesh.creation.cone(0.05, 0.12, sections=40),
        "ring": trimesh.creation.annulus(0.05, 0.07, 0.03, sections=24),
    }
    found = []
    for name, mesh in meshes.items():
        mesh.apply_transform(upright)
        vertices, diagonal = canonical_frame(mesh.vertices, mesh.faces)
        shape = trimesh.Trimesh(vertices, mesh.faces, process=False)
        asset = Asset(id=name, category="other", mesh=shape)
        found.append(PhysicalObject(asset, diagonal, convex_parts(asset)))
    return found


def procedural_objects(seed: int, cache: Path, *, variety: int = 1) -> list[PhysicalObject]:
    """One of each category, each of the first few shapes."""
    rng = np.random.default_rng(seed)
    found = []
    for category in CATEGORIES:
        asset = make(category, int(rng.integers(variety)))
        found.append(PhysicalObject(asset, draw_diagonal(rng, asset), convex_parts(asset, cache)))
    return found


def check_settled(objects: Sequence[PhysicalObject], poses: Sequence[SE3]) -> None:
    """Nothing overlaps by a millimetre, hovers or moves on; judged on the visual meshes."""
    placed = [
        PlacedObject(f"{k} {o.asset.id}", o.asset.scaled(o.diagonal_m), T)
        for k, (o, T) in enumerate(zip(objects, poses, strict=True))
    ]
    deep = [
        (p.first, p.second, p.depth_m) for p in find_penetrations(placed, tolerance_m=DEEPEST_M)
    ]
    assert deep == []
    lowest = [float((T @ t.mesh.vertices)[:, 2].min()) for t, T in zip(placed, poses, strict=True)]
    assert min(lowest) > -DEEPEST_M
    # Something lies on the floor.
    assert min(lowest) < 0.0003
    assert drift(objects, poses, 0.5) < DEEPEST_M
