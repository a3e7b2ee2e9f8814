"""Differences between two poses of one object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3, rotation_angle
from std_toolkit.geometry.symmetry import Symmetry


def rotation_error(estimate: SE3, truth: SE3, symmetry: Symmetry | None = None) -> float:
    """Smallest rotation angle in radians between two poses over the object's symmetries."""
    return min(
        rotation_angle((truth.R @ S.R).T @ estimate.R)
        for S in (symmetry or Symmetry()).transforms(steps=360)
    )


def translation_error(estimate: SE3, truth: SE3) -> float:
    """Distance in metres between the origins of two poses."""
    return float(np.linalg.norm(estimate.t - truth.t))


def mssd(
    estimate: SE3,
    truth: SE3,
    vertices: NDArray[np.floating],
    symmetry: Symmetry | None = None,
    *,
    steps: int = 360,
) -> float:
    """Maximum symmetry-aware surface distance, metres.

    Source: T. Hodan et al., "BOP Challenge 2020", equation 3. The maximum of a linear map's
    length over a mesh is reached at a vertex of its convex hull: passing hull vertices is exact
    and fast.

    Args:
        estimate, truth: T_cam_obj or T_world_obj of both.
        vertices: (V, 3) mesh or hull vertices, object frame, metres.
        symmetry: of the object; none means the identity alone.
        steps: samples of a full turn for continuous symmetries.
    """
    p = estimate @ np.asarray(vertices, dtype=np.float64)
    return min(
        float(np.linalg.norm(p - (truth @ S @ vertices), axis=1).max())
        for S in (symmetry or Symmetry()).transforms(steps=steps)
    )
