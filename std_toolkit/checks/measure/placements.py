"""Labels against each other and against their meshes: overlaps, and symmetries that do not hold."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

from std_toolkit.checks.measure.contours import mesh_problem
from std_toolkit.checks.result import ObjectCheck, Value
from std_toolkit.geometry.symmetry_search import CheckedTurn, check_symmetry
from std_toolkit.labels.support.penetration import find_penetrations
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.scene import Scene

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.geometry.symmetry import Symmetry

# Contacts and small errors of labels are no overlap.
_TOLERANCE_M = 0.003


def with_placements(scene: Scene, objects: Sequence[ObjectCheck]) -> list[ObjectCheck]:
    """The rows with `overlap_mm` and `symmetry_mm`; see `ObjectCheck.values`."""
    found: defaultdict[int, list[Value]] = defaultdict(list)
    placed = {}
    for item in objects:
        pose = scene.T_world_obj(item.object)
        if pose is not None and mesh_problem(scene, item.model) is None:
            placed[str(item.object)] = PlacedObject(str(item.object), scene.mesh(item.model), pose)
    names = {str(o.object): o.name for o in objects}
    for pair in find_penetrations(list(placed.values()), tolerance_m=_TOLERANCE_M):
        for own, other in ((pair.first, pair.second), (pair.second, pair.first)):
            if not any(v.key == "overlap_mm" for v in found[int(own)]):
                found[int(own)].append(
                    Value(
                        key="overlap_mm",
                        value=round(1000 * pair.depth_m, 2),
                        unit="mm",
                        source="label",
                        text=names[other],
                    )
                )
    for item in objects:
        if str(item.object) not in placed:
            continue
        symmetry = scene.objects.model(item.model).symmetry.symmetry()
        turn = None if symmetry.is_trivial else _worst_turn(scene.mesh(item.model), symmetry)
        if turn is not None:
            found[item.object].append(
                Value(
                    key="symmetry_mm",
                    value=round(1000 * turn.distance_m, 2),
                    unit="mm",
                    source="label",
                    text="" if turn.fits else "the mesh is another one after it",
                )
            )
    return [o.with_values(found[o.object]) for o in objects]


# A study judges one scene with many faults.
@lru_cache(maxsize=64)
def _worst_turn(mesh: trimesh.Trimesh, symmetry: Symmetry) -> CheckedTurn | None:
    return check_symmetry(mesh, symmetry)
