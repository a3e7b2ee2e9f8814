"""Covariance of a refined pose: noise of the measurements, errors of the cameras, disagreement.

The information of the normal equations covers noise that is independent between samples. Two
errors are not independent within a view: that of its camera pose, which moves the whole view, and
those of light, mesh and reflections, which show as views that disagree about the pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.edges.system import WeightedRows
from std_toolkit.labels.refine.problem import RefineView

Array = NDArray[np.float64]

# Eigenvalues of a view's information below this fraction of the largest say nothing.
_NOTHING = 1e-6

# Weight of the expectation that views agree, in directions.
_PRIOR_DIRECTIONS = 6

# Variance of refined poses over that of the model, fitted by perf/label_deviation.py on the
# recordings of seeds 100 to 115: reflections in metal are errors that all views share.
_MATERIAL_FACTOR = {"specular": 1.35, "transparent": 0.9}
_OPAQUE_FACTOR = 0.7


def pose_covariance(
    formal: Array,
    rows: Sequence[WeightedRows],
    views: Sequence[RefineView],
    T_world_obj: SE3,
    material: str,
) -> Array:
    """(6, 6) covariance of a right perturbation of one object's pose.

    Args:
        formal: (6, 6) inverse of the information, for independent noise.
        rows: the object's rows at the refined pose, of all views.
        views: by the rows' `view`.
        T_world_obj: the refined pose.
        material: of the object.
    """
    factor = _MATERIAL_FACTOR.get(material, _OPAQUE_FACTOR)
    spread = np.zeros((6, 6))
    by_view: dict[int, tuple[Array, Array]] = {}
    for one in rows:
        A, b = by_view.get(one.view, (np.zeros((6, 6)), np.zeros(6)))
        by_view[one.view] = A + one.pose_information, b + one.pose_gradient
    expected = {}
    for k, (A, _) in by_view.items():
        expected[k] = A + A @ _camera_spread(views[k], T_world_obj) @ A
        spread += expected[k] - A
    covariance = factor * formal + formal @ spread @ formal
    return covariance * disagreement([(expected[k], b) for k, (_, b) in by_view.items()])


def disagreement(views: Sequence[tuple[Array, Array]]) -> float:
    """Factor on a covariance, at least 1, by which views disagree more than their noise explains.

    The reduced chi-square of the views' gradients at the solution (Birge ratio, squared), drawn
    towards 1 when few views determine it.

    Args:
        views: (6, 6) expected covariance of the gradient and (6,) gradient of each view.
    """
    total, directions = 0.0, 0
    for expected, gradient in views:
        size = np.sqrt(np.maximum(np.diag(expected), 1e-30))
        values, vectors = np.linalg.eigh(expected / np.outer(size, size))
        known = values > _NOTHING * values[-1]
        total += float(((vectors.T @ (gradient / size))[known] ** 2 / values[known]).sum())
        directions += int(known.sum())
    free = directions - 6
    if free <= 0:
        return 1.0
    return max(1.0, (total + _PRIOR_DIRECTIONS) / (free + _PRIOR_DIRECTIONS))


def _camera_spread(view: RefineView, T_world_obj: SE3) -> Array:
    """(6, 6) covariance of the object's motion relative to a camera of uncertain pose."""
    if view.pose_covariance is None:
        return np.zeros((6, 6))
    # T_cam_world exp(-c) T_world_obj = T_cam_obj exp(-Ad c): a motion of the camera is one of the
    # object.
    move = (T_world_obj.inverse() @ view.T_world_cam).adjoint()
    return np.asarray(move @ view.pose_covariance @ move.T)
