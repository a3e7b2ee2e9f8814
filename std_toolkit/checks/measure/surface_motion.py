"""Where sensor depth puts each object, from the readings of all frames."""

from __future__ import annotations

from collections.abc import Sequence

from std_toolkit.checks.measure.aggregate import AggregateSettings
from std_toolkit.checks.measure.contours import mesh_problem, object_centre
from std_toolkit.checks.measure.depth_motion import depth_motion
from std_toolkit.checks.measure.motion_solver import symmetry_motions
from std_toolkit.checks.measure.residuals import FrameObservation
from std_toolkit.checks.measure.shared_errors import seen_errors
from std_toolkit.checks.result import ObjectCheck
from std_toolkit.scene import Scene


def with_surface_motions(
    scene: Scene, objects: Sequence[ObjectCheck], observed: Sequence[FrameObservation]
) -> list[ObjectCheck]:
    """The rows with `surface_mm`, of objects whose sensor depth can be trusted."""
    return [_with_motion(scene, item, observed) for item in objects]


def _with_motion(
    scene: Scene, item: ObjectCheck, observed: Sequence[FrameObservation]
) -> ObjectCheck:
    T_world_obj = scene.T_world_obj(item.object)
    if not item.is_labelled or T_world_obj is None or mesh_problem(scene, item.model) is not None:
        return item
    least = AggregateSettings.current().judged_fraction
    rows = {
        frame.frame: seen.surface
        for frame in observed
        if (seen := frame.objects.get(item.object)) is not None
        and seen.surface is not None
        and seen.visible_fraction >= least
    }
    centre = object_centre(scene, item.object)
    symmetry = scene.objects.model(item.model).symmetry.symmetry()
    free = symmetry_motions(symmetry, T_world_obj, centre)
    found = depth_motion(list(rows.values()), free, seen_errors(scene, rows, centre))
    return item if found is None else item.with_values([found])
