"""All grasps of a table's first view, judged by the true meshes: GraspNet's average precision.

The hand carries out one grasp of a view, and the views after it differ from planner to planner.
The first view is the same for all, and what was planned there tells more than one attempt.
"""

from __future__ import annotations

from benchmark.clearing.round import Attempt
from benchmark.grasping.ap import JudgedObject, average_precision, judge_grasps, precision_at
from std_toolkit.geometry.se3 import SE3

PRECISION = ("ap", "ap08", "ap04")


def precision_of(attempt: Attempt, T_world_cam: SE3) -> dict[str, float]:
    """GraspNet's AP, AP0.8 and AP0.4 of what was planned on a view, as shares."""
    objects = [
        JudgedObject.of_mesh(o.body.asset.vertices * o.body.diagonal_m, o.body.asset.faces)
        for o in attempt.before.objects
    ]
    T_cam_world = T_world_cam.inverse()  # z = 0 of the world is the table
    poses = [T_cam_world @ T for T in attempt.before.poses]
    judged = judge_grasps(attempt.planned, objects, poses, T_cam_world)
    found = average_precision([precision_at(judged.friction)])
    return {name: getattr(found, name) / 100 for name in PRECISION}
