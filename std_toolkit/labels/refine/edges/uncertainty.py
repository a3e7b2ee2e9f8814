"""Covariances of refined poses: noise, errors of cameras, mesh and texture, and other starts.

The normal equations weigh the measurements. What their solution is wrong by has several causes, and
only noise averages out over samples and views:

- noise of edges, depth and matches, independent between samples that are far enough apart;
- the error of a camera pose, alike for all samples of a view, as far as `poses.json` states it;
- errors that all views share: the size of the mesh along each axis, edges beside the rim of the
  mesh, a texture that is shifted on a side of the mesh;
- views that disagree by more than all this;
- where the refinement ends when it starts elsewhere.

Errors that views share are consider parameters (S. F. Schmidt, "Application of state-space methods
to navigation problems", 1966): they are not corrected, but what the residuals tell of their size
is propagated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.edges.system import Kind, NormalEquations, WeightedRows
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.scene.scale_model import SOURCE_ERRORS

Array = NDArray[np.float64]

# Eigenvalues of a view's information below this fraction of the largest say nothing.
_NOTHING = 1e-6

# Weight of the expectation that views agree, in directions.
_PRIOR_DIRECTIONS = 6

# The numbers below agree with the errors on recordings of seeds 200 to 216 and 240 to 257 in
# perf/label_deviation.py; others judge them.

# Pixels of a contour that have one error in common: edges are averaged along it, and glass and
# metal show edges of their surroundings over long pieces of it. Likewise sensor readings, which are
# thinned, and matches.
_EDGE_PX = {"specular": 150.0, "transparent": 150.0}
_OPAQUE_EDGE_PX = 40.0
_READINGS, _MATCHES = 4.0, 1.0

# Weak prior of the motion of an object in one view, metres and radians.
_MOVED_M, _MOVED_RAD = 0.05, 0.35

# Relative deviation of a mesh's size along each axis.
_MESH_SIZE = SOURCE_ERRORS["cad"]

# Deviation of the edges in the image from the rim of the mesh, full-resolution pixels. A mirror
# shows the table on which it stands, and no edge towards it.
_RIM_PX = {"specular": 0.6}
_OTHER_RIM_PX = 0.2

# Part of the variance of shared errors that residuals do not show, because a mesh is wrong in more
# ways than these.
_UNSEEN = 0.02

# Deviation of the texture of one side from its place on the mesh, metres.
_TEXTURE_M = 0.0003


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
    causes = list(_causes(rows, views, poses, objects, scale))
    # Variance of the gradient: priors as they are, noise, and errors of the cameras.
    independent = system.A.copy()
    for one in causes:
        at = np.ix_(system.places(one.rows), system.places(one.rows))
        independent[at] += one.noise - one.rows.weighted(one.rows.jacobian)
    for k in sorted({one.rows.view for one in causes}):
        shaken = np.zeros((len(system.b), 6))
        for one in causes:
            if one.rows.view == k:
                shaken[system.places(one.rows)] += one.rows.weighted(one.camera)
        independent += shaken @ shaken.T
    found = []
    for i, obj in enumerate(objects):
        own = [one for one in causes if one.rows.index == i]
        at_i = slice(6 * i, 6 * i + 6)
        spread = disagreement(_by_view(own)) * independent
        if own:
            shared = np.zeros((len(system.b), own[0].shared.shape[1]))
            for one in own:
                shared[system.places(one.rows)] += one.rows.weighted(one.shared)
            moment = _second_moment(own, system.A[at_i, at_i], obj.radius)
            spread = spread + shared @ moment @ shared.T
        block = inverse[at_i] @ spread @ inverse[:, at_i]
        if len(ends[i]):
            block += np.mean([np.outer(xi, xi) for xi in ends[i]], axis=0)
        found.append((block + block.T) / 2)
    return found


def disagreement(views: Sequence[tuple[Array, Array]], *, least: float = 1.0) -> float:
    """Factor on a covariance by which views disagree more than their noise explains.

    The reduced chi-square of the views' gradients at the solution (Birge ratio, squared), drawn
    towards 1 when few views determine it.

    Args:
        views: (6, 6) expected covariance of the gradient and (6,) gradient of each view.
        least: smallest factor.
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
    return max(least, (total + _PRIOR_DIRECTIONS) / (free + _PRIOR_DIRECTIONS))


@dataclass(frozen=True, eq=False)
class _Causes:
    """Rows, and what their residuals are made of.

    Attributes:
        rows: the measurements.
        noise: (6 + K, 6 + K) variance of their gradient by independent noise.
        camera: (N, 6) residuals by independent errors of the camera pose, one deviation each.
        shared: (N, M) residuals by independent errors that all views share, one deviation each.
    """

    rows: WeightedRows
    noise: Array
    camera: Array
    shared: Array


def _causes(
    rows: Sequence[WeightedRows],
    views: Sequence[RefineView],
    poses: Sequence[SE3],
    objects: Sequence[RefineObject],
    scale: float,
) -> Iterator[_Causes]:
    by_view: dict[tuple[int, int], list[WeightedRows]] = {}
    for one in rows:
        by_view.setdefault((one.index, one.view), []).append(one)
    weak = np.diag([_MOVED_M**-2] * 3 + [_MOVED_RAD**-2] * 3)
    for (i, k), mine in by_view.items():
        A = np.sum([one.pose_information for one in mine], axis=0)
        b = np.sum([one.pose_gradient for one in mine], axis=0)
        # What all residuals of the object in the view agree on is no noise.
        moved = np.linalg.solve(A + weak, b)
        for one in mine:
            yield _Causes(
                one,
                _noise(one, one.residual - one.jacobian[:, :6] @ moved, objects[i].material),
                _of_camera(one, views[k], poses[i]),
                np.hstack([_of_mesh(one, objects[i], scale), _of_texture(one, objects[i])]),
            )


def _noise(one: WeightedRows, left: Array, material: str) -> Array:
    """Variance of the gradient by the noise of residuals, from these themselves.

    H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48, 1980.
    """
    if one.kind == "contour":
        alike = max(1.0, _EDGE_PX.get(material, _OPAQUE_EDGE_PX) / one.spacing)
    else:
        alike = _READINGS if one.kind == "depth" else _MATCHES
    square = (one.information * left) ** 2
    return np.asarray(alike * one.jacobian.T @ (one.jacobian * square[:, None]))


def _of_camera(one: WeightedRows, view: RefineView, T_world_obj: SE3) -> Array:
    """(N, 6) residuals by the independent errors of the camera pose."""
    if view.pose_covariance is None:
        return np.zeros((len(one.residual), 6))
    # T_cam_world exp(-c) T_world_obj = T_cam_obj exp(-Ad c): a motion of the camera is one of the
    # object.
    move = (T_world_obj.inverse() @ view.T_world_cam).adjoint()
    values, vectors = np.linalg.eigh(view.pose_covariance)
    return np.asarray(one.jacobian[:, :6] @ move @ (vectors * np.sqrt(np.maximum(values, 0))))


def _of_mesh(one: WeightedRows, obj: RefineObject, scale: float) -> Array:
    """(N, 9) residuals by a mesh of another size along each axis, and by edges beside its rim.

    Light, shadow and what is behind an outline depend on where it faces: edges are off by another
    amount towards each of six directions of the object.
    """
    by_point = one.jacobian[:, :3]
    size = _MESH_SIZE * by_point * (one.points - obj.centre)
    facing = np.zeros((len(size), 6))
    if one.kind == "contour":
        rim = scale * _RIM_PX.get(obj.material, _OTHER_RIM_PX)
        outward = by_point / np.maximum(np.linalg.norm(by_point, axis=1, keepdims=True), 1e-12)
        facing = rim * _facing(outward)
    return np.hstack([size, facing])


def _of_texture(one: WeightedRows, obj: RefineObject) -> Array:
    """(N, 18) residuals by a shift of the texture on the sides that face six directions."""
    shift = np.zeros((len(one.residual), 6, 3))
    if one.kind == "texture":
        _, normals = obj.surface.closest(one.points)
        outward = np.where(
            ((one.points - obj.centre) * normals).sum(axis=1, keepdims=True) < 0, -normals, normals
        )
        facing = _facing(outward)
        shift = _TEXTURE_M * facing[:, :, None] * one.jacobian[:, None, :3]
    return shift.reshape(len(shift), 18)


def _facing(outward: Array) -> Array:
    """(N, 6) components of unit vectors along the directions of the axes; squares add up to 1."""
    return np.hstack([np.maximum(outward, 0), np.maximum(-outward, 0)])


def _by_view(own: Sequence[_Causes]) -> list[tuple[Array, Array]]:
    """Expected covariance of the gradient of one object, and the gradient, of each view."""
    found = []
    for k in sorted({one.rows.view for one in own}):
        mine = [one for one in own if one.rows.view == k]
        expected = np.sum([one.noise[:6, :6] for one in mine], axis=0)
        for columns in ("camera", "shared"):
            moved = np.sum([one.rows.weighted(getattr(one, columns))[:6] for one in mine], axis=0)
            expected = expected + moved @ moved.T
        found.append((expected, np.sum([one.rows.pose_gradient for one in mine], axis=0)))
    return found


def _second_moment(own: Sequence[_Causes], information: Array, radius: float) -> Array:
    """(M, M) mean square of the shared errors of one object, given its residuals.

    Before the residuals are known it is the identity. An error that they determine counts as it
    is, so that exact meshes get smaller deviations than wrong ones.

    Args:
        own: of the object.
        information: (6, 6) on its pose, with the priors.
        radius: of the object, metres; balances metres and radians.
    """
    balance = np.array([1.0] * 3 + [1 / radius] * 3)
    kinds: dict[Kind, list[_Causes]] = {}
    for one in own:
        kinds.setdefault(one.rows.kind, []).append(one)
    count = own[0].shared.shape[1]
    total = np.eye(6 + count)
    total[:6, :6] = information - np.sum([one.rows.pose_information for one in own], axis=0)
    sums = np.zeros(6 + count)
    for mine in kinds.values():
        A = np.sum([one.rows.pose_information for one in mine], axis=0)
        noise = np.sum([one.noise[:6, :6] for one in mine], axis=0)
        # The weights allow for more than noise.
        share = np.trace(noise * np.outer(balance, balance)) / np.trace(
            A * np.outer(balance, balance)
        )
        for one in mine:
            J = np.hstack([one.rows.jacobian[:, :6], one.shared])
            weight = one.rows.information / max(float(share), 1e-3)
            total += J.T @ (J * weight[:, None])
            sums += J.T @ (one.rows.residual * weight)
    size = np.concatenate([balance, np.ones(count)])
    inverse = np.linalg.inv(total * np.outer(size, size)) * np.outer(size, size)
    mean = (inverse @ sums)[6:]
    return np.asarray(np.outer(mean, mean) + inverse[6:, 6:] + _UNSEEN * np.eye(count))
