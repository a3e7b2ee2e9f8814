"""The table of a run: the outcome of every object and of every attempt.

Each round has a row of kind `object` for each object at its start, and a row of kind `attempt` for
each view, with or without an executed grasp. The table does not depend on run time or machine.

All grasps of a jaw planned on the first view of a table are also scored on the true meshes with
GraspNet's average precision, which is not defined for suction. The first view is the same for all
planners; later views differ, because only one grasp per view is executed.
"""

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
    """Return GraspNet's AP, AP0.8 and AP0.4 of the grasps planned on a view, 0 to 1."""
    objects = [
        JudgedObject.of_mesh(o.body.asset.vertices * o.body.diagonal_m, o.body.asset.faces)
        for o in attempt.before.objects
    ]
    T_cam_world = T_world_cam.inverse()  # z = 0 of the world is the table
    poses = [T_cam_world @ T for T in attempt.before.poses]
    judged = judge_grasps(attempt.planned, objects, poses, T_cam_world)
    found = average_precision([precision_at(judged.friction)])
    return {name: getattr(found, name) / 100 for name in PRECISION}


# Defaults that keep the type of the columns in rows of the other kind.
_NOTHING = {
    "number": -1, "asset": "", "category": "", "material": "", "diagonal_m": np.nan,
    "mass_kg": np.nan, "fate": "", "fate_attempt": -1,
    "attempt": -1, "present": -1, "found": -1, "executed": False, "outcome": "", "held": 0,
    "lost": 0, "target": -1, "score": np.nan, "width": np.nan, "depth": np.nan,
    **{f"{what}_{a}": np.nan for what in ("tip", "approach", "closing") for a in _AXES},
    "opening": np.nan, "pushed_m": np.nan, **dict.fromkeys(PRECISION, np.nan),
}  # fmt: skip


def scene_name(index: int) -> str:
    """Return the name of round `index`."""
    return f"round-{index:04d}"


def rows_of_round(
    index: int,
    arrangement: Arrangement,
    attempts: Sequence[Attempt],
    T_world_cam: SE3,
    *,
    judged: bool = True,
) -> list[dict[str, Any]]:
    """Return the rows of a round: its objects, then its attempts.

    Args:
        index: index of the round.
        arrangement, attempts: objects at the start, and attempts.
        T_world_cam: camera pose.
        judged: whether planned grasps have an average precision: those of a jaw do.
    """
    base = {INDEX: index, SCENE: scene_name(index), FRAME: "", ERROR: ""}
    fates = {o.number: (LEFT, -1) for o in arrangement.objects}
    for attempt in attempts:
        fates |= dict.fromkeys(attempt.removed, (GRASPED, attempt.number))
        fates |= dict.fromkeys(attempt.lost, (LOST, attempt.number))
    rows: list[dict[str, Any]] = []
    for o in arrangement.objects:
        fate, when = fates[o.number]
        properties = {
            "number": o.number,
            "asset": o.body.asset.id,
            "category": o.body.asset.category,
            "material": o.material.material_class,
            "diagonal_m": o.body.diagonal_m,
            "mass_kg": o.mass_kg,
            "fate": fate,
            "fate_attempt": when,
        }
        rows.append(base | {KIND: OBJECT} | _NOTHING | properties)
    views = [base | {KIND: ATTEMPT} | _NOTHING | _attempt(a) for a in attempts]
    for view in views[: int(judged)]:
        view |= precision_of(attempts[0], T_world_cam)
    return rows + views


def _attempt(attempt: Attempt) -> dict[str, Any]:
    row: dict[str, Any] = {
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
        return row
    target = _target(attempt)
    row |= {
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
        row |= {f"{what}_{a}": float(x) for a, x in zip(_AXES, vector, strict=True)}
    closed = [s.opening for s in executed.stages if s.name == "closed"]
    return row | ({"opening": closed[0]} if closed else {})


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
