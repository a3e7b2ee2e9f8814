"""Sentences on a refinement: how it was done, and what to doubt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.labels.refine.auto_problem import AutoProblem
from std_toolkit.labels.refine.problem import RefineObject
from std_toolkit.labels.refine.weakness import covariance_at

UNSETTLED = "the refinement did not settle: its last step still moved it; refine again, and look"

# Standard deviation along the viewing ray beyond which the distance is called weak, metres.
_WEAK_M = 0.003
# A contour that fits scatters by one or two pixels.
_LOOSE_PX = 4.0
_LITTLE_EXPLAINED = 0.5


def method_sentence(edge_rms_px: float | None, depth_m: float | None, views: int) -> str:
    """What a label's provenance says, such as "depth and edges, 7 views, edges 0.6 px"."""
    means = [
        name for name, value in (("depth", depth_m), ("edges", edge_rms_px)) if value is not None
    ]
    parts = [" and ".join(means), f"{views} view{'s' if views != 1 else ''}"]
    if edge_rms_px is not None:
        parts.append(f"edges {edge_rms_px:.1f} px")
    if depth_m is not None:
        parts.append(f"depth {1000 * depth_m:.1f} mm")
    return ", ".join(parts)


def doubts(
    problem: AutoProblem,
    thing: RefineObject,
    covariance: NDArray[np.floating],
    edge_rms_px: float | None,
    depth_m: float | None,
    explained: float | None,
) -> list[str]:
    """What a person should look at, as sentences.

    Args:
        thing: at its refined pose.
        covariance: (6, 6) of a right perturbation.
    """
    found = []
    if len(problem.views) == 1 and depth_m is None:
        along = _std_along_ray(problem, thing, covariance)
        found.append(
            f"one view without depth: the distance to the camera is weak (about "
            f"{1000 * along:.0f} mm); check it in another frame or on the table"
        )
    if edge_rms_px is not None and edge_rms_px > _LOOSE_PX:
        found.append(
            f"the edges scatter by {edge_rms_px:.1f} px around the contour; is the mesh the right "
            "one, and the start near enough?"
        )
    if explained is not None and explained < _LITTLE_EXPLAINED:
        found.append(
            f"only {100 * explained:.0f} % of the sensor depth on it agrees with the mesh; is it "
            "opaque, and the mesh the right one?"
        )
    return found


def _std_along_ray(
    problem: AutoProblem, thing: RefineObject, covariance: NDArray[np.floating]
) -> float:
    """Standard deviation of the object's centre along the ray of the first view, metres."""
    centre = thing.T_world_obj @ thing.centre
    ray = centre - problem.views[0].T_world_cam.t
    ray = thing.T_world_obj.R.T @ ray / np.linalg.norm(ray)
    C = covariance_at(covariance, thing.centre)[:3, :3]
    return float(np.sqrt(max(float(ray @ C @ ray), 0.0)))
