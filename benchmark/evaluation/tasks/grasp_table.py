"""The table of a run: what became of every object and of every attempt.

Each round has a row of kind `object` for each object at its start, and one of kind `attempt` for
each view that something was, or could not be, tried upon. Nothing in it depends on how long
anything took or where it ran.

All grasps of a table's first view, judged by the true meshes: GraspNet's average precision.

The hand carries out one grasp of a view, and the views after it differ from planner to planner.
The first view is the same for all, and what was planned there tells more than one attempt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmark.evaluation.results import ERROR, FRAME, INDEX, SCENE
from benchmark.metrics.grasp.ap import JudgedObject, average_precision, judge_grasps, precision_at
from benchmark.tabletop.arrange import Arrangement
from benchmark.tabletop.round import Attempt, target_of
from std_toolkit.geometry.se3 import SE3

PRECISION = ("ap", "ap08", "ap04")

ATTEMPTS = "attempts.parquet"

KIND, OBJECT, ATTEMPT = "kind", "object", "attempt"

GRASPED, LOST, LEFT = "grasped", "off-table", "left"

_POINTS = 1500

_AXES = ("x", "y", "z")


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


# Columns of the other kind of rows keep their type.
_NOTHING = {
    "number": -1, "asset": "", "category": "", "material": "", "diagonal_m": np.nan,
    "mass_kg": np.nan, "fate": "", "fate_attempt": -1,
    "attempt": -1, "present": -1, "found": -1, "executed": False, "outcome": "", "held": 0,
    "lost": 0, "target": -1, "score": np.nan, "width": np.nan, "depth": np.nan,
    **{f"{what}_{a}": np.nan for what in ("tip", "approach", "closing") for a in _AXES},
    "opening": np.nan, "pushed_m": np.nan, **dict.fromkeys(PRECISION, np.nan),
}  # fmt: skip


def scene_name(index: int) -> str:
    """What round `index` is called."""
    return f"round-{index:04d}"


def rows_of_round(
    index: int, arrangement: Arrangement, attempts: Sequence[Attempt], T_world_cam: SE3
) -> list[dict[str, Any]]:
    """The rows of a round: its objects, then its attempts.

    Args:
        index: of the round.
        arrangement, attempts: what stood there, and what was tried upon it.
        T_world_cam: where the camera stands.
    """
    base = {INDEX: index, SCENE: scene_name(index), FRAME: "", ERROR: ""}
    fates = {o.number: (LEFT, -1) for o in arrangement.objects}
    for attempt in attempts:
        fates |= dict.fromkeys(attempt.removed, (GRASPED, attempt.number))
        fates |= dict.fromkeys(attempt.lost, (LOST, attempt.number))
    rows: list[dict[str, Any]] = []
    for o in arrangement.objects:
        fate, when = fates[o.number]
        told = {
            "number": o.number,
            "asset": o.body.asset.id,
            "category": o.body.asset.category,
            "material": o.material.material_class,
            "diagonal_m": o.body.diagonal_m,
            "mass_kg": o.mass_kg,
            "fate": fate,
            "fate_attempt": when,
        }
        rows.append(base | {KIND: OBJECT} | _NOTHING | told)
    views = [base | {KIND: ATTEMPT} | _NOTHING | _attempt(a) for a in attempts]
    for view in views[:1]:
        view |= precision_of(attempts[0], T_world_cam)
    return rows + views


def _attempt(attempt: Attempt) -> dict[str, Any]:
    told: dict[str, Any] = {
        "attempt": attempt.number,
        "present": len(attempt.before.objects),
        "found": attempt.found,
        "executed": attempt.executed is not None,
        "outcome": attempt.outcome,
        "held": len(attempt.removed),
        "lost": len(attempt.lost),
    }
    grasp, executed = attempt.grasp, attempt.executed
    if grasp is None or executed is None:
        return told
    target = _target(attempt)
    told |= {
        "target": target.number,
        "category": target.body.asset.category,
        "material": target.material.material_class,
        "score": float(grasp.scores[0]),
        "width": float(grasp.widths[0]),
        "depth": float(grasp.depths[0]),
        "pushed_m": executed.pushed_m,
    }
    for what, vector in (
        ("tip", grasp.tips[0]),
        ("approach", grasp.approaches[0]),
        ("closing", grasp.closings[0]),
    ):
        told |= {f"{what}_{a}": float(x) for a, x in zip(_AXES, vector, strict=True)}
    closed = [s.opening for s in executed.stages if s.name == "closed"]
    return told | ({"opening": closed[0]} if closed else {})


def _target(attempt: Attempt) -> Any:
    import trimesh

    points = []
    for obj, T in zip(attempt.before.objects, attempt.before.poses, strict=True):
        mesh = obj.body.asset.mesh
        canonical = np.asarray(trimesh.sample.sample_surface(mesh, _POINTS, seed=0)[0])
        points.append(T @ (canonical * obj.body.diagonal_m))
    place = target_of(attempt, points)
    assert place is not None
    return attempt.before.objects[place]
