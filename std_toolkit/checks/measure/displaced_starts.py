"""Where an object is whose contour is not seen at its label.

The motion of a contour is solved from edges near it. On glass and steel a label that is far off
finds too few of them. It is displaced to all sides then, and measured again from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.contours import mesh_problem
from std_toolkit.checks.measure.motion_solver import symmetry_motions
from std_toolkit.checks.measure.object_motion import moved_item
from std_toolkit.checks.measure.object_views import MeasuredPose, ObjectViews
from std_toolkit.checks.measure.shared_errors import SharedErrors, seen_errors
from std_toolkit.checks.result import ObjectCheck
from std_toolkit.labels.refine_step import scene_object
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Frame, Scene
from std_toolkit.settings import Settings, limit

_FRAMES = 6


@dataclass(frozen=True, kw_only=True)
class StartSettings(Settings):
    """Where an object is looked for, and when it is there."""

    distance: float = limit(
        2.4, source="profiles of 16 px reach twice to four times a limit from there"
    )
    """length of a displacement, in largest motions that are accepted"""
    gain: Mapping[str, float] = limit(
        {"specular": 2.0, "transparent": 2.0},
        unit="nats",
        source="world seeds 400 to 424 of setting kinds",
    )
    """log likelihood of independent samples by which the contour must fit better there than at the
    label; by material, others are not looked for"""


def with_displaced_starts(
    scene: Scene,
    objects: Sequence[ObjectCheck],
    frames: Sequence[Frame],
    options: CheckOptions,
    *,
    up: Array,
) -> list[ObjectCheck]:
    """The rows of the objects; those that are not seen at their labels have the motion to where
    they are seen.

    Args:
        scene: with labels.
        objects: rows with motions.
        frames: registered frames that were measured.
        options: limits.
        up: (3,) unit vector that points up in the world.
    """
    views = ObjectViews(scene, frames)
    return [
        found
        if _is_sought(o) and (found := _found_elsewhere(scene, o, views, options, up)) is not None
        else o
        for o in objects
    ]


def _is_sought(item: ObjectCheck) -> bool:
    support = item.entry("support")
    if support is None or item.material not in StartSettings.current().gain:
        return False
    return support.text in ("faint", "absent", "loose")


def _found_elsewhere(
    scene: Scene, item: ObjectCheck, views: ObjectViews, options: CheckOptions, up: Array
) -> ObjectCheck | None:
    T = scene.T_world_obj(item.object)
    if T is None or mesh_problem(scene, item.model) is not None:
        return None
    limits = StartSettings.current()
    obj = scene_object(scene, item.object, T)
    seen = views.of_object(item.object, obj, views.large(T @ obj.centre, obj.radius, _FRAMES))
    if not seen:
        return None
    centre = next(iter(seen.values())).centre
    free = symmetry_motions(obj.symmetry, T, centre)
    label = MeasuredPose.of(seen, np.zeros(6), free)
    if label is None:
        return None
    eye = np.mean([views.poses[k].t for k in seen], axis=0)
    length = limits.distance * options.max_motion_mm / 1000
    best, start = label, np.zeros(6)
    for step in length * _directions(centre - eye):
        motion = np.append(step, np.zeros(3))
        there = MeasuredPose.of(seen, motion, free)
        if there is not None and there.total > best.total:
            best, start = there, motion
    if best.total - label.unmoved < limits.gain[item.material]:
        return None
    ids = [views.frames[k].id for k in best.equations]
    moved = moved_item(
        msgspec.structs.replace(item, values=[]),
        list(best.equations.values()),
        free,
        options,
        axes=T.R,
        shared=SharedErrors.of_material(item.material, up),
        cameras=seen_errors(scene, ids, centre + start[:3]),
    )
    if moved.text("confirmed") != "yes":
        return None
    return _from_label(item, moved, start)


def _directions(along: Array) -> Array:
    """(6, 3) unit vectors: sideways, upwards and along the mean line of sight, both ways."""
    z = along / np.linalg.norm(along)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    return np.concatenate([axes, -axes])


def _from_label(item: ObjectCheck, moved: ObjectCheck, start: Array) -> ObjectCheck:
    """The row with the values of a displaced label, the motion counted from the label itself."""
    values = []
    for value in moved.values:
        if value.key == "label_support":
            continue
        if value.key == "motion_mm" and value.motion is not None:
            motion = np.array(value.motion)
            motion[:3] += 1000 * start[:3]
            value = msgspec.structs.replace(
                value,
                value=round(float(np.linalg.norm(motion[:3])), 2),
                motion=[round(float(x), 2) for x in motion],
            )
        values.append(value)
    keys = {v.key for v in values}
    return msgspec.structs.replace(
        item, values=[*(v for v in item.values if v.key not in keys), *values]
    )
