"""The grasps of a scene that are known: those of its objects that hit nothing else there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.grasping.collision import hits_plane
from benchmark.grasping.gripper import Gripper
from benchmark.grasping.surface import even_points
from benchmark.training.grasps.object_labels import ObjectLabels
from benchmark.training.grasps.tabletop import TableObject
from std_toolkit.geometry.se3 import SE3

# Grasps that are tested at once.
_AT_ONCE = 200_000
# Metres between the points that stand for the surfaces of other objects, and by which grippers
# grow so that nothing passes between them.
_SPACING = 0.006


@dataclass(frozen=True, eq=False)
class SceneLabels:
    """Rows of grasps, a row for each point of an object that some view of the scene sees.

    Attributes:
        object: (R,) number of the object.
        point: (R,) number of the point of its labels.
        friction: (R, v, a, d) uint8: 1 for a friction of 0.2, 2 for 0.4, ...; 0 for no grasp, or
            one that hits something.
        widths, tolerances: (R, v, a, d) uint8 half millimetres.
    """

    object: NDArray[np.uint8]
    point: NDArray[np.int32]
    friction: NDArray[np.uint8]
    widths: NDArray[np.uint8]
    tolerances: NDArray[np.uint8]


def scene_labels(
    objects: Sequence[TableObject],
    labels: Sequence[ObjectLabels],
    seen: Sequence[NDArray[np.integer]],
    gripper: Gripper,
) -> SceneLabels:
    """Labels of the points that are seen.

    Args:
        objects: of the scene; the table is z = 0.
        labels: of each object.
        seen: numbers of each object's points that are, in rising order.
        gripper: what must not hit the table and the other objects.
    """
    surfaces = [o.T_world_obj @ even_points(o.vertices, o.faces, _SPACING) for o in objects]
    numbers, points, friction, widths, tolerances = [], [], [], [], []
    for number, (thing, own, rows) in enumerate(zip(objects, labels, seen, strict=True)):
        if not len(rows):
            continue
        around = [s for other, s in enumerate(surfaces) if other != number]
        others = np.concatenate(around) if around else np.zeros((0, 3))
        codes = own.friction[rows].copy()
        codes[_hits(thing, own, rows, gripper, others)] = 0
        numbers.append(np.full(len(rows), number, np.uint8))
        points.append(np.asarray(rows, np.int32))
        friction.append(codes)
        widths.append(own.widths[rows])
        tolerances.append(own.tolerances[rows])
    if not numbers:
        grid = labels[0].friction.shape[1:] if labels else (0, 0, 0)
        none = np.zeros((0, *grid), np.uint8)
        return SceneLabels(np.zeros(0, np.uint8), np.zeros(0, np.int32), none, none, none)
    return SceneLabels(
        *(np.concatenate(p) for p in (numbers, points, friction, widths, tolerances))
    )


def _hits(
    thing: TableObject,
    labels: ObjectLabels,
    rows: NDArray[np.integer],
    gripper: Gripper,
    others: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """(r, v, a, d) grasps of the rows that hit the table or other objects."""
    from benchmark.training.grasps.hits import any_inside

    codes = labels.friction[rows]
    hit = np.zeros(codes.shape, bool)
    good = np.flatnonzero(codes)
    for begin in range(0, len(good), _AT_ONCE):
        part = good[begin : begin + _AT_ONCE]
        grasps = labels.grasps(rows, part).transformed(thing.T_world_obj)
        wrong = hits_plane(grasps, gripper, SE3.identity())
        free = np.flatnonzero(~wrong)
        boxes = gripper.boxes(grasps.widths[free], grasps.depths[free])
        wrong[free] = any_inside(
            others,
            grasps.rotations[free],
            grasps.translations[free],
            boxes,
            margin=_SPACING / 2,
        )
        hit.reshape(-1)[part] = wrong
    return hit
