"""Spread of refined poses over several starts near them.

The edge that a contour point finds depends on where it was searched from, and so does the pose. The
finest level is repeated from starts a few deviations away: where it ends differs by as much as
refinements from far starts that find the same edges differ, at a fraction of their time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine import problem
from std_toolkit.labels.refine.caster import LayerStore
from std_toolkit.labels.refine.edges.descent import descend
from std_toolkit.labels.refine.edges.measure import Level, PoseState

Array = NDArray[np.float64]

# Starts are this many deviations away, but not so far that a contour leaves the reach of its level.
_AWAY, _REACH = 2.0, 0.5


def end_elsewhere(
    views: Sequence[problem.RefineView],
    objects: Sequence[problem.RefineObject],
    state: PoseState,
    covariances: Sequence[Array],
    level: Level,
    options: problem.RefineOptions,
    *,
    layers: LayerStore,
    progress: problem.Progress = problem.no_progress,
) -> list[list[Array]]:
    """Repeat the last level from other starts.

    Args:
        views: views whose contours were followed.
        objects: all objects; fixed ones are not moved.
        state: the refined poses; not changed.
        covariances: (6, 6) of each pose, of independent noise.
        level: the finest level.
        options: of the refinement; `restarts` is the number of starts.
        layers: cached layers of the objects in the views.
        progress: called with the completed fraction.

    Returns:
        By object, the (6,) right perturbations from its refined pose to where each repetition
        ended; empty for fixed objects.
    """
    found: list[list[Array]] = [[] for _ in objects]
    # A fixed object is held at the pose of the record.
    held = [
        replace(o, T_world_obj=T) if o.fixed else o
        for o, T in zip(objects, state.poses, strict=True)
    ]
    moving = [k for k, o in enumerate(objects) if not o.fixed]
    if not moving:
        return found
    rng = np.random.default_rng(0)
    for number in range(options.restarts):
        poses = list(state.poses)
        for k in moving:
            reach = _REACH * level.reach * _pixel_m(views, objects[k], state.poses[k], level)
            poses[k] = poses[k] @ SE3.exp(_away(objects[k], covariances[k], reach, rng))
        again = PoseState(poses, state.log_scale, state.depth_factor)
        within = number / options.restarts, (number + 1) / options.restarts
        try:
            descend(
                views,
                held,
                again,
                [level],
                options,
                layers=layers,
                progress=problem.sub_progress(progress, *within),
            )
        except ToolkitError:  # nothing is visible
            continue
        for k in moving:
            found[k].append((state.poses[k].inverse() @ again.poses[k]).log())
    return found


def _away(
    obj: problem.RefineObject, covariance: Array, reach_m: float, rng: np.random.Generator
) -> Array:
    """(6,) a motion of some deviations that moves the surface by at most `reach_m`."""
    values, vectors = np.linalg.eigh(covariance)
    xi = _AWAY * vectors @ (np.sqrt(np.maximum(values, 0)) * rng.normal(size=6))
    moved = np.linalg.norm(xi[:3] + np.cross(xi[3:], obj.centre)) + np.linalg.norm(
        xi[3:] * obj.radius
    )
    return np.asarray(xi * min(1.0, reach_m / max(float(moved), 1e-12)))


def _pixel_m(
    views: Sequence[problem.RefineView], obj: problem.RefineObject, T_world_obj: SE3, level: Level
) -> float:
    """Size of the level's pixels at the object, in the nearest view, metres."""
    centre = T_world_obj @ obj.centre
    depths = [(v.T_world_cam.inverse() @ centre)[2] / v.camera.fx for v in views]
    ahead = [d for d in depths if d > 0]
    return min(ahead, default=0.001) / level.scale
