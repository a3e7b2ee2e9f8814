"""Rigid transforms of the numbers in a file of poses, all rows at once.

The row of the first number that is wrong is named; `at` gives its place in the file by its index.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry import SE3
from std_toolkit.geometry.se3 import nearest_rotation, rotation_of_quat
from std_toolkit.settings import Settings, limit

Place = Callable[[int], str]


@dataclass(frozen=True, kw_only=True)
class CameraTableSettings(Settings):
    """Which numbers of a file are a camera pose."""

    largest_deviation: float = limit(
        1e-2,
        source="poses of KinectFusion in float32 are 1.9e-4 off; files of three decimals are up to "
        "2e-3 off, a scale of 1 % is 2e-2 off",
    )
    """largest entry of `R R^T - I` of a rotation R that is taken for one with rounding errors"""
    largest_turn: float = limit(
        6.3, unit="rad", source="a turn is 2 pi; angles in degrees are larger in most rows"
    )
    """longest rotation vector"""
    farthest_camera: float = limit(
        2.0,
        unit="m",
        source="a hand is shorter; millimetres read as metres are 20 m and more",
    )
    """farthest that a camera may be from the flange of a hand-eye calibration"""


def poses_or_lost(
    values: Sequence[Any] | Array, path: Path, at: Place
) -> tuple[Array, frozenset[int]]:
    """Matrices (N, 4, 4) of rows of 16 or 12 numbers in any nesting, and the rows that are lost.

    A pose of an image that a tracker lost is null, blank, or has a number that is not finite or a
    rotation of zeros; its matrix is the identity. `rigid` makes poses of the others.

    Raises:
        ToolkitError: other numbers, or not a rigid transform; the row is named.
    """
    try:
        M = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        M = np.empty(0)
    if len(M) != len(values) or not _is_matrix(M.shape[1:]):
        rows = [_pose_or_lost(value, path, at(i)) for i, value in enumerate(values)]
        lost = frozenset(i for i, row in enumerate(rows) if row is None)
        return np.array([np.eye(4) if row is None else row for row in rows]), lost
    M = _of_four_rows(M)
    absent = ~np.isfinite(M[:, :3]).all((1, 2)) | ~M[:, :3, :3].any((1, 2))
    M[absent] = np.eye(4)
    _scaled(M, path, at)
    return M, frozenset(map(int, np.flatnonzero(absent)))


def _pose_or_lost(value: Any, path: Path, at: str) -> Array | None:
    if value is None or (isinstance(value, list | str) and not value):
        return None
    try:
        shape = np.asarray(value, dtype=np.float64).shape
    except (TypeError, ValueError):
        flat = list(_flat(value))
        if flat and all(x is None or str(x).lower() in ("", "null", "none", "nan") for x in flat):
            return None
    else:
        if _is_matrix(shape):
            matrices, lost = poses_or_lost([value], path, lambda _: at)
            return None if lost else np.asarray(matrices[0])
    return as_matrix(value, path, at)


def _flat(value: Any) -> Iterator[Any]:
    if isinstance(value, list | tuple):
        for item in value:
            yield from _flat(item)
    else:
        yield value


def _is_matrix(shape: tuple[int, ...]) -> bool:
    return shape in ((4, 4), (3, 4), (16,), (12,))


def as_matrix(value: Any, path: Path, at: str) -> Array:
    """Return 16 or 12 numbers in any nesting as (4, 4), of which `rigid` makes a pose.

    Raises:
        ToolkitError: other numbers, or not a rigid transform; `at` names the place.
    """
    try:
        M = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ToolkitError("not a matrix of numbers", path=path, field=at) from error
    if not _is_matrix(M.shape):
        raise ToolkitError(
            "a camera pose needs 4x4 (or 3x4) numbers", path=path, field=at,
            value=f"{M.size} numbers",
        )  # fmt: skip
    M = _of_four_rows(M[None])
    _scaled(M, path, lambda _: at)
    return np.asarray(M[0])


def _of_four_rows(M: Array) -> Array:
    """(N, 4, 4) of (N, 16), (N, 12), (N, 4, 4) or (N, 3, 4); a copy."""
    M = M.reshape(len(M), -1, 4)
    whole = np.tile(np.eye(4), (len(M), 1, 1))
    whole[:, : M.shape[1]] = M
    return whole


def rotation_deviations(M: Array) -> Array:
    """Largest entry of `R R^T - I` of the rotations of homogeneous matrices (N, 4, 4): (N,).

    R is the upper left block, or this block over w if that is nearer to a rotation.
    """
    R = M[:, :3, :3]
    return np.minimum(_off(R), _off(R / M[:, 3, 3, None, None]))


def _off(R: Array) -> Array:
    return np.asarray(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max((1, 2)))


def rigid(M: Array, path: Path) -> Array:
    """The rigid transforms (N, 4, 4) of homogeneous matrices with the last row 0 0 0 w.

    A homogeneous matrix is known up to a factor, so that M / w is the pose, if its rotation is
    one. Some writers scale only the translation by w: the rotation is one as it is filed.

    Raises:
        ToolkitError: a matrix that is no rigid transform.
    """
    scaled = _scaled(M, path, lambda i: f"[{i}]")
    R = scaled[:, :3, :3]
    rough = _off(R) >= 1e-14
    U, _, Vt = np.linalg.svd(R[rough])
    R[rough] = U @ Vt
    return scaled


def _scaled(M: Array, path: Path, at: Place) -> Array:
    """Transforms with the last row 0 0 0 1 whose rotations are right up to rounding."""
    limit = CameraTableSettings.current().largest_deviation
    M = M.copy()
    w = M[:, 3, 3]
    odd = ~np.isfinite(M).all((1, 2)) | (np.abs(M[:, 3, :3]).max(1) > 1e-6 * np.abs(w)) | (w == 0)
    for i in map(int, np.flatnonzero(odd)):
        with located(path, at(i)):
            M[i] = SE3.from_matrix(M[i]).matrix()  # which refuses it
    w = M[:, 3, 3]
    whole = M[:, :3] / w[:, None, None]
    is_one = (w > 0) & (_off(M[:, :3, :3]) <= limit)
    whole[is_one, :, :3] = M[is_one, :3, :3]
    R = whole[:, :, :3]
    wrong = (np.linalg.det(R) < 0) | (_off(R) > limit)
    if wrong.any():
        first = int(np.argmax(wrong))
        with located(path, at(first)):
            nearest_rotation(R[first], tolerance=limit)
    return _of_four_rows(whole)


def quaternion_poses(wxyz: Array, t: Array, path: Path, at: Place) -> Array:
    """Poses (N, 4, 4) of quaternions (N, 4), which are normalised, and translations (N, 3).

    Raises:
        ToolkitError: a quaternion that is far from unit length; the row is named.
    """
    norms = np.linalg.norm(wxyz, axis=1)
    wrong = ~(np.abs(norms - 1) <= 1e-2)
    if wrong.any():
        first = int(np.argmax(wrong))
        with located(path, at(first)):
            SE3.from_quat(wxyz[first], t[first])
    return _posed(rotation_of_quat(wxyz / norms[:, None]), t)


def rotation_vector_poses(vectors: Array, t: Array, path: Path, at: Place) -> Array:
    """Poses (N, 4, 4) of rotation vectors (N, 3), radians, and translations (N, 3).

    Raises:
        ToolkitError: a vector of more than a turn; the row is named.
    """
    from scipy.spatial.transform import Rotation

    wrong = np.linalg.norm(vectors, axis=1) > CameraTableSettings.current().largest_turn
    if wrong.any():
        first = int(np.argmax(wrong))
        raise ToolkitError(
            "a rotation vector is in radians", path=path, field=at(first),
            value=vectors[first].tolist(),
            hint="are these degrees, or Euler angles? convert them",
        )  # fmt: skip
    return _posed(Rotation.from_rotvec(vectors).as_matrix(), t)


def _posed(R: Array, t: Array) -> Array:
    return _of_four_rows(np.concatenate([R, t[:, :, None]], axis=2))
