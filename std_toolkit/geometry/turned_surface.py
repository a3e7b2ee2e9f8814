"""A surface after a turn compared with itself: points, axes to try, alignment, distances.

Also the axis of a rotational shape.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3, so3_exp

Array = NDArray[np.float64]
Closest: TypeAlias = Callable[[Array], tuple[NDArray[np.floating], NDArray[np.floating]]]

# Axes nearer to one another are the same.
SAME_AXIS = float(np.deg2rad(12))

Basis: TypeAlias = tuple[Array, tuple[str, str, str]]

# A normal that points to the axis within this sine belongs to a surface of revolution ...
_ALIGNED = 0.2

# ... which must cover this fraction of the sides; the rest is handles and spouts.
_SHARE = 0.6

# A bowl is part of a sphere, which is symmetric about every axis: the ratio of its width to its
# depth is at most this.
_RIM = 1.1
_ROUNDS = 8


def spread_points(
    vertices: Array, faces: NDArray[np.integer], count: int
) -> tuple[Array, NDArray[np.int64], Array]:
    """Points spread over a surface by its area; the same at every call.

    Returns:
        (N, 3) points; (N,) the face of each; (N, 2) barycentric weights of its second and third
        corner. N is `count`, or less for a mesh without area, which gives vertices.
    """
    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    total = np.cumsum(area)
    if total[-1] <= 0:
        face = np.arange(min(count, len(faces)))
        return corners[face, 0], face, np.zeros((len(face), 2))
    random = np.random.default_rng(0)
    at = (np.arange(count) + random.random(count)) / count * total[-1]
    face = np.minimum(np.searchsorted(total, at), len(faces) - 1)
    a, b = random.random((2, count))
    flip = a + b > 1
    a[flip], b[flip] = 1 - a[flip], 1 - b[flip]
    p = corners[face]
    points = p[:, 0] + a[:, None] * (p[:, 1] - p[:, 0]) + b[:, None] * (p[:, 2] - p[:, 0])
    return np.asarray(points), face.astype(np.int64), np.stack([a, b], axis=1)


def axes_to_try(points: Array) -> list[Basis]:
    """Sets of three axes to turn about: those of the mesh, and its principal ones if they differ.

    The principal axes of each pair of mesh axes are tried as well: a bottle stands upright in its
    mesh frame but may look anywhere.
    """
    found: list[Basis] = [(np.eye(3), ("x", "y", "z"))]
    centred = points - (points.min(axis=0) + points.max(axis=0)) / 2
    _, _, principal = np.linalg.svd(centred, full_matrices=False)
    candidates = [principal]
    for k in range(3):
        i, j = (m for m in range(3) if m != k)
        _, _, flat = np.linalg.svd(centred[:, [i, j]], full_matrices=False)
        axes = np.zeros((3, 3))
        axes[:2, i], axes[:2, j], axes[2, k] = flat[:, 0], flat[:, 1], 1.0
        candidates.append(axes)
    for axes in candidates:
        if any(_same_axes(axes, known) for known, _ in found):
            continue
        names = tuple(axis_name(a) for a in axes)
        found.append((axes, names))  # type: ignore[arg-type]
    return found


def _same_axes(a: Array, b: Array) -> bool:
    """Whether two sets of axes hold the same lines."""
    return bool((np.abs(a @ b.T).max(axis=1) > np.cos(SAME_AXIS)).all())


def axis_name(axis: Array) -> str:
    """The name of a mesh axis, or the direction in words."""
    k = int(np.argmax(np.abs(axis)))
    if abs(axis[k]) > np.cos(SAME_AXIS):
        return "xyz"[k]
    axis = axis if axis[k] > 0 else -axis
    return "the axis (" + ", ".join(f"{x + 0.0:.2f}" for x in axis) + ")"


def turn_about(centre: Array, R: Array) -> SE3:
    """Rotation R about a point."""
    return SE3(R, centre - R @ centre)


def align_turn(
    turn: SE3, points: Array, closest: Closest, *, centre: Array, radius: float, steps: int
) -> SE3:
    """Move a turn so that the turned points lie on the surface as well as they can.

    Robust point-to-plane steps. A weak prior keeps the directions that the shape leaves free, such
    as the angle about the axis of a bottle.

    Args:
        turn: T_obj_turned to start from.
        points: (N, 3) on the surface.
        closest: nearest surface points (N, 3) of points (N, 3), and the normals there.
        centre: (3,) about which the steps rotate.
        radius: of the object, metres.
        steps: number of steps.
    """
    size = np.array([1.0] * 3 + [1 / radius] * 3)
    for _ in range(steps):
        p = turn @ points
        nearest, normal = closest(p)
        gap = ((nearest - p) * normal).sum(axis=1)
        spread = max(1.4826 * float(np.median(np.abs(gap))), 1e-6)
        weight = 1 / (1 + (gap / (2 * spread)) ** 2)
        J = np.hstack([normal, np.cross(p - centre, normal)]) * size
        A = (J * weight[:, None]).T @ J + 0.02 * weight.sum() * np.eye(6)
        xi = size * np.linalg.solve(A, (J * weight[:, None]).T @ gap)
        R = so3_exp(xi[3:])
        turn = SE3(R, xi[:3] + centre - R @ centre) @ turn
    return turn


def round_axis(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> int | None:
    """The coordinate axis (0, 1, 2) about which most of a mesh is rotationally symmetric, or None.

    For bottles, cans, bowls and mugs this is the vertical axis, whichever axis their data set
    calls up. Shapes with several such axes, such as a sphere, give None.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    middles = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    shares = [
        _turned_share(np.delete(middles, axis, axis=1), np.delete(normals, axis, axis=1))
        for axis in range(3)
    ]
    turned = [axis for axis in range(3) if shares[axis] > _SHARE]
    if len(turned) > 1:
        extents = np.ptp(corners.reshape(-1, 3), axis=0)
        rims = [np.delete(extents, axis) for axis in range(3)]
        turned = [axis for axis in turned if rims[axis].max() <= _RIM * rims[axis].min()]
    return turned[0] if len(turned) == 1 else None


def _turned_share(places: Array, normals: Array) -> float:
    """Fraction of the sides whose normals meet in one point, seen along an axis.

    Args:
        places: (N, 2) centres of the faces.
        normals: (N, 2) their normals times their areas.
    """
    size = np.linalg.norm(normals, axis=1)
    sides = size > 1e-6 * max(float(size.max(initial=0.0)), 1e-30)
    if not sides.any():
        return 0.0
    places, size = places[sides], size[sides]
    across = np.stack([-normals[sides, 1], normals[sides, 0]], axis=1) / size[:, None]
    # across . (place - centre) = 0 for every face of a surface of revolution: least absolute
    # residuals.
    weight = size.copy()
    for _ in range(_ROUNDS):
        system = np.einsum("n,ni,nj->ij", weight, across, across)
        centre = np.linalg.lstsq(
            system, np.einsum("n,ni,nj,nj->i", weight, across, across, places), rcond=None
        )[0]
        missed = np.abs(np.einsum("ni,ni->n", across, places - centre))
        weight = size / np.maximum(missed, 0.01 * max(float(np.median(missed)), 1e-9))
    radius = np.linalg.norm(places - centre, axis=1)
    return float(size[missed <= _ALIGNED * radius].sum() / size.sum())
