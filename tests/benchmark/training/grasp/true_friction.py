"""At which friction grasps of a known scene truly hold, by the meshes alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.grasp.collision import Cloud, hits_plane
from benchmark.metrics.grasp.force_closure import GraspedMesh, even_points
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import Gripper
from benchmark.training.grasp.tabletop import TableObject
from std_toolkit.geometry.se3 import SE3

_SPACING = 0.004  # metres between the points that stand for objects


def true_friction(
    objects: Sequence[TableObject], grasps: Grasps, gripper: Gripper
) -> NDArray[np.float64]:
    """(N,) least friction at which grasps of a scene truly hold, -1 for none or a collision.

    Args:
        objects: of the scene; the table is z = 0.
        grasps: in the world.
        gripper: that must hit nothing.
    """
    held = np.full(len(grasps), -1.0)
    if not len(grasps):
        return held
    placed = [(o, o.T_world_obj @ o.vertices) for o in objects]
    for thing, vertices in placed:
        own = GraspedMesh(vertices, thing.faces).friction_scores(grasps)
        # Of two objects between the fingers that hold, whichever needs less.
        better = (own > 0) & ((held < 0) | (own < held))
        held[better] = own[better]
    surface = np.concatenate([even_points(v, o.faces, _SPACING) for o, v in placed])
    hit = Cloud(surface).hit_by(grasps, gripper) | hits_plane(grasps, gripper, SE3.identity())
    held[hit] = -1
    return held
