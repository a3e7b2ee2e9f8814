"""Simulated objects as models of a toolkit scene: at their real size, with names."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sensors.output.frame import SimulatedObject, SimulatedScene
from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.importers.foreign_files import mesh_suffix, model_of_mesh
from std_toolkit.scene.document import safe_name
from std_toolkit.scene.model import ContinuousSymmetry, Model, SymmetryModel

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class MetricObject:
    """An object as a scene or a recording holds it.

    Attributes:
        name: unique in the scene: its category and its instance id.
        model: row of the model table.
        mesh: vertices in metres; the poses of the simulated object hold for it.
    """

    item: SimulatedObject
    name: str
    model: Model
    mesh: trimesh.Trimesh


def metric_objects(scene: SimulatedScene) -> list[MetricObject]:
    """Every object with a model of its own size; two sizes of one asset are two models."""
    uses = Counter(o.asset_id for o in scene.objects)
    found = []
    for item in scene.objects:
        model_id = item.asset_id
        if uses[item.asset_id] > 1:
            model_id = safe_name(f"{item.instance_id}_{item.asset_id}")
        mesh = item.mesh.copy()
        mesh.apply_scale(item.scale_m)
        model = model_of_mesh(
            mesh,
            model_id=model_id,
            category=item.category,
            symmetry=metric_symmetry(item.symmetry, item.scale_m),
            class_id=item.class_id,
            suffix=mesh_suffix(mesh),
        )
        found.append(
            MetricObject(item, safe_name(f"{item.category}_{item.instance_id}"), model, mesh)
        )
    return found


def metric_symmetry(symmetry: Symmetry, scale_m: float) -> SymmetryModel:
    """Symmetries of the canonical mesh, of the mesh at a size in metres."""
    discrete = [SE3.from_matrix(T) for T in symmetry.discrete]
    return SymmetryModel(
        discrete=[SE3(T.R, scale_m * T.t).flat() for T in discrete],
        continuous=[
            ContinuousSymmetry(axis=list(axis), offset=(scale_m * np.asarray(offset)).tolist())
            for axis, offset in symmetry.continuous
        ],
    )
