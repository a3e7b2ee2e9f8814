"""Covariances of refined poses: noise, errors of cameras, mesh and print, and other starts.

The normal equations weigh the measurements. What their weighted sum is wrong by has several causes,
and only noise averages out over samples and views:

- noise of edges, depth and matches, independent between samples that are far enough apart;
- the error of a camera pose, alike for all samples of a view, as far as `poses.json` states it;
- errors of the mesh and of the edges that its rim shows in the image, alike in all views: its size
  along each axis, an outline that is too wide, a print that is shifted on one of its sides;
- views that disagree by more than all this enlarge the noise;
- where the refinement ends when it starts elsewhere.

The errors that all samples share are consider parameters (S. F. Schmidt, "Application of
state-space methods to navigation problems", 1966): not estimated, but propagated.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.edges.system import NormalEquations, WeightedRows
from std_toolkit.labels.refine.problem import RefineObject, RefineView

Array = NDArray[np.float64]

# Eigenvalues of a view's information below this fraction of the largest say nothing.
_NOTHING = 1e-6

# Weight of the expectation that views agree, in directions.
_PRIOR_DIRECTIONS = 6

# Variance of the noise over that of the weights, which allow for errors alike in all views.
_EDGE_NOISE = {"specular": 0.5, "transparent": 0.25}
_OPAQUE_EDGE_NOISE = 0.25
_NOISE = {"depth": 0.25, "print": 0.25}

# Relative deviation of a mesh's size along each axis: that of a CAD mesh in the scale report.
_MESH_SIZE = 0.004

# Deviation of the edges in the image from the rim of the mesh, full-resolution pixels.
_RIM_PX = {"specular": 0.25, "transparent": 0.2}
_OPAQUE_RIM_PX = 0.1

# Deviation of the print of one side from its place on the mesh, metres.
_PRINT_M = 0.0004


def pose_covariances(
    system: NormalEquations,
    rows: Sequence[WeightedRows],
    views: Sequence[RefineView],
    poses: Sequence[SE3],
    objects: Sequence[RefineObject],
    ends: Sequence[Sequence[Array]],
    *,
    scale: float = 1.0,
) -> list[Array]:
    """(6, 6) covariance of a right perturbation of each object's pose.

    Args:
        system: the normal equations at the refined poses.
        rows: the measurements in it.
        views: by the rows' `view`.
        poses: refined T_world_obj.
        objects: in the order of the poses.
        ends: by object, where refinements from other starts ended, as right perturbations.
        scale: image scale of the rows.
    """
    inverse = system.covariance([o.radius for o in objects])
    # Variance of the gradient, of all objects: noise with the priors, and errors of the cameras.
    independent = system.A.copy()
    for one in rows:
        at = np.ix_(system.places(one), system.places(one))
        independent[at] -= (1 - _noise(one, objects)) * one.weighted(one.jacobian)
    for k in sorted({one.view for one in rows}):
        shaken = [(r, _of_camera(r, views[k], poses)) for r in rows if r.view == k]
        independent += _shared(system, shaken)
    found = []
    for i, obj in enumerate(objects):
        own = [r for r in rows if r.index == i]
        alike = np.zeros_like(independent)
        for errors in (_of_mesh(own, obj, scale), *_of_print(own, obj)):
            alike += _shared(system, errors)
        factor = disagreement(_by_view(own, objects, views, poses))
        at_i = slice(6 * i, 6 * i + 6)
        block = inverse[at_i] @ (factor * independent + alike) @ inverse[:, at_i]
        if len(ends[i]):
            block += np.mean([np.outer(xi, xi) for xi in ends[i]], axis=0)
        found.append((block + block.T) / 2)
    return found


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


def _by_view(
    rows: Sequence[WeightedRows],
    objects: Sequence[RefineObject],
    views: Sequence[RefineView],
    poses: Sequence[SE3],
) -> list[tuple[Array, Array]]:
    """Expected covariance of the gradient of one object, and the gradient, of each view."""
    found = []
    for k in sorted({one.view for one in rows}):
        mine = [one for one in rows if one.view == k]
        expected = np.zeros((6, 6))
        for one in mine:
            expected += _noise(one, objects) * one.pose_information
        moved = sum(one.weighted(_of_camera(one, views[k], poses)) for one in mine)
        found.append((expected + moved[:6] @ moved[:6].T, sum(one.pose_gradient for one in mine)))
    return found


def _noise(one: WeightedRows, objects: Sequence[RefineObject]) -> float:
    """Variance of the noise of rows over that of their weights."""
    if one.kind == "contour":
        return _EDGE_NOISE.get(objects[one.index].material, _OPAQUE_EDGE_NOISE)
    return _NOISE[one.kind]


def _shared(system: NormalEquations, errors: Iterable[tuple[WeightedRows, Array]]) -> Array:
    """Variance of the gradient by errors that rows share.

    Args:
        system: the normal equations.
        errors: (N, K) residuals of the rows by K independent errors of one deviation each.
    """
    total = None
    for one, columns in errors:
        if total is None:
            total = np.zeros((len(system.b), columns.shape[1]))
        total[system.places(one)] += one.weighted(columns)
    return np.zeros_like(system.A) if total is None else total @ total.T


def _of_camera(one: WeightedRows, view: RefineView, poses: Sequence[SE3]) -> Array:
    """(N, 6) residuals by the independent errors of the camera pose."""
    if view.pose_covariance is None:
        return np.zeros((len(one.residual), 6))
    # T_cam_world exp(-c) T_world_obj = T_cam_obj exp(-Ad c): a motion of the camera is one of the
    # object.
    move = (poses[one.index].inverse() @ view.T_world_cam).adjoint()
    values, vectors = np.linalg.eigh(view.pose_covariance)
    return np.asarray(one.jacobian[:, :6] @ move @ (vectors * np.sqrt(np.maximum(values, 0))))


def _of_mesh(
    rows: Sequence[WeightedRows], obj: RefineObject, scale: float
) -> list[tuple[WeightedRows, Array]]:
    """(N, 4) residuals by a mesh of another size along each axis, and by a rim too wide."""
    rim = scale * _RIM_PX.get(obj.material, _OPAQUE_RIM_PX)
    found = []
    for one in rows:
        by_point = one.jacobian[:, :3]
        size = _MESH_SIZE * by_point * (one.points - obj.centre)
        wide = np.full((len(size), 1), rim if one.kind == "contour" else 0.0)
        found.append((one, np.hstack([size, wide])))
    return found


def _of_print(
    rows: Sequence[WeightedRows], obj: RefineObject
) -> list[list[tuple[WeightedRows, Array]]]:
    """(N, 3) residuals by a shift of the print, for each side that has matches."""
    found: dict[int, list[tuple[WeightedRows, Array]]] = {}
    extents = np.maximum(np.ptp(obj.vertices, axis=0), 1e-9)
    for one in rows:
        if one.kind != "print":
            continue
        at = (one.points - obj.centre) / extents
        axis = np.abs(at).argmax(axis=1)
        side = 2 * axis + (at[np.arange(len(at)), axis] > 0)
        for k in np.unique(side):
            there = _PRINT_M * one.jacobian[:, :3] * (side == k)[:, None]
            found.setdefault(int(k), []).append((one, there))
    return list(found.values())
