"""Shapes that all simulated sets of the tests are made of."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh


@pytest.fixture(scope="module")
def shapes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Convex meshes, which cost no decomposition."""
    folder = tmp_path_factory.mktemp("shapes")
    for name, mesh in {
        "box/small.obj": trimesh.creation.box((0.1, 0.06, 0.08)),
        "ball/plain.obj": trimesh.creation.icosphere(3, 0.05),
        "drum/flat.obj": trimesh.creation.cylinder(0.05, 0.06, sections=48),
    }.items():
        (folder / name).parent.mkdir(exist_ok=True)
        mesh.export(folder / name)
    return folder
