"""Which object of one annotator is which of the other: by name, else by mesh and place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annotator.agreement.labelled import LabelledObject
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.scene import Model, Scene

# Two copies of one mesh, as far as exporters and file formats keep it.
_SAME_MESH_M = 1e-4
_FAR = 1e6


@dataclass(frozen=True, eq=False)
class Match:
    """Two labels of one physical object.

    Attributes:
        by: "name", or "place": the names differ, but the mesh is the same and no other object of
            it lies nearer.
    """

    a: LabelledObject
    b: LabelledObject
    by: str


@dataclass(frozen=True, eq=False)
class Matching:
    """Outcome of a matching; what is labelled by one only is left over."""

    matches: list[Match]
    only_a: list[LabelledObject]
    only_b: list[LabelledObject]


def match_objects(a: Sequence[LabelledObject], b: Sequence[LabelledObject]) -> Matching:
    """Match the labelled objects of two annotators.

    Objects of equal names belong together. Of the others, those of the same mesh do whose centres
    lie nearest to each other, and less than the object's diameter apart.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    by_name = {x.name: x for x in b}
    matches = [Match(x, by_name[x.name], "name") for x in a if x.name in by_name]
    named = {m.a.name for m in matches}
    left_a = [x for x in a if x.name not in named]
    left_b = [x for x in b if x.name not in named]
    if left_a and left_b:
        cost = np.array([[_place_cost(x, y) for y in left_b] for x in left_a])
        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            if cost[i, j] < _FAR:
                matches.append(Match(left_a[i], left_b[j], "place"))
    matched_a = {m.a.name for m in matches}
    matched_b = {m.b.name for m in matches}
    return Matching(
        matches,
        [x for x in a if x.name not in matched_a],
        [x for x in b if x.name not in matched_b],
    )


def same_mesh(x: LabelledObject, y: LabelledObject) -> bool:
    """Whether the meshes of two objects have the same shape in the same mesh frame.

    Raises:
        ToolkitError: a mesh is missing or damaged.
    """
    return same_shape(x.owner.scene, x.model, y.owner.scene, y.model)


def same_shape(scene_a: Scene, a: Model, scene_b: Scene, b: Model) -> bool:
    """As `same_mesh`, of models of two scenes."""
    if scene_a.mesh_digest(a.id) == scene_b.mesh_digest(b.id):
        return True
    # The same mesh in another file format.
    bounds = mesh_bounds(scene_a.mesh(a.id)) - mesh_bounds(scene_b.mesh(b.id))
    return bool(
        np.abs(bounds).max() < _SAME_MESH_M and abs(a.diameter_m - b.diameter_m) < _SAME_MESH_M
    )


def distance_between(x: LabelledObject, y: LabelledObject) -> float:
    """Distance of the centres in metres, median over the common frames; inf without any."""
    common = sorted(x.poses.keys() & y.poses.keys())
    if not common:
        return float("inf")
    chosen = [common[int(i)] for i in np.linspace(0, len(common) - 1, min(9, len(common)))]
    return float(
        np.median([np.linalg.norm(x.poses[f] @ x.centre - y.poses[f] @ y.centre) for f in chosen])
    )


def _place_cost(x: LabelledObject, y: LabelledObject) -> float:
    if not same_mesh(x, y):
        return _FAR
    apart = distance_between(x, y)
    return apart if apart < x.model.diameter_m else _FAR
