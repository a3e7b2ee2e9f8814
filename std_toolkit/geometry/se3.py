"""Rigid transforms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError

Array = NDArray[np.float64]

# A rotation read from a file with 6 significant digits is off by up to about 1e-5.
ROTATION_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class SE3:
    """A rigid transform: `p_a = T_a_b @ p_b` for points of shape (..., 3).

    Use `from_matrix` or `from_quat` for external input: they check that it is a rotation. The
    constructor is for computed values and checks only the shapes.

    Attributes:
        R: (3, 3) rotation, float64.
        t: (3,) translation in metres, float64.

    Raises:
        ToolkitError: R or t of another shape.
    """

    R: Array
    t: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "R", np.asarray(self.R, dtype=np.float64))
        object.__setattr__(self, "t", np.asarray(self.t, dtype=np.float64))
        if self.R.shape != (3, 3) or self.t.shape != (3,):
            raise ToolkitError(
                "a pose has a 3x3 rotation and 3 translations", value=(self.R.shape, self.t.shape)
            )

    @staticmethod
    def identity() -> SE3:
        """The pose that moves nothing."""
        return SE3(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(T: ArrayLike) -> SE3:
        """From a (4, 4) or (3, 4) matrix, or its 16 or 12 entries row-major.

        The rotation is projected to the nearest exact one, so that rounding errors of printed
        digits do not accumulate.

        Raises:
            ToolkitError: the entries are not finite, the upper-left part is not a rotation to 1e-4,
                or the last row is not 0 0 0 1.
        """
        M = _numbers(T)
        if M.shape not in ((4, 4), (3, 4), (16,), (12,)):
            raise ToolkitError("a pose needs 16 (or 12) numbers, row-major", value=M.shape)
        M = M.reshape(-1, 4)
        if not np.isfinite(M).all():
            raise ToolkitError("a pose contains a number that is not finite", value=M.tolist())
        if len(M) == 4 and not np.allclose(M[3], [0, 0, 0, 1], atol=1e-6):
            raise ToolkitError(
                "the last row of a pose must be 0 0 0 1",
                value=M[3].tolist(),
                hint="is the matrix transposed (column by column)?"
                if np.allclose(M[:, 3], [0, 0, 0, 1], atol=1e-6)
                else "",
            )
        return SE3(nearest_rotation(M[:3, :3]), M[:3, 3].copy())

    @staticmethod
    def from_quat(wxyz: ArrayLike, t: ArrayLike) -> SE3:
        """From a quaternion (w, x, y, z), which is normalised, and a translation in metres.

        Raises:
            ToolkitError: a number is not finite or the quaternion is far from unit length.
        """
        q, translation = _numbers(wxyz), _numbers(t)
        if q.shape != (4,) or translation.shape != (3,):
            raise ToolkitError(
                "a pose needs 4 quaternion and 3 translation numbers",
                value=(q.shape, translation.shape),
            )
        norm = float(np.linalg.norm(q))
        if not np.isfinite(norm) or abs(norm - 1) > 1e-2:
            raise ToolkitError(
                "a rotation quaternion (w x y z) must have length 1", value=q.tolist()
            )
        if not np.isfinite(translation).all():
            raise ToolkitError("a translation is not finite", value=translation.tolist())
        # Copied, because the arrays of a simulation change later.
        return SE3(rotation_of_quat(q / norm), translation.copy())

    @staticmethod
    def exp(xi: ArrayLike) -> SE3:
        """Exponential map of `xi` (6,) = (rho, phi): translation part, then rotation vector."""
        rho, phi = np.split(np.asarray(xi, dtype=np.float64).reshape(6), 2)
        return SE3(so3_exp(phi), _left_jacobian(phi) @ rho)

    def log(self) -> Array:
        """Inverse of `exp`: (6,) = (rho, phi), with |phi| <= pi."""
        phi = so3_log(self.R)
        return np.concatenate([np.linalg.solve(_left_jacobian(phi), self.t), phi])

    def inverse(self) -> SE3:
        """T_b_a of T_a_b."""
        return SE3(self.R.T, -self.R.T @ self.t)

    def adjoint(self) -> Array:
        """(6, 6) A with `T @ SE3.exp(xi) = SE3.exp(A @ xi) @ T` for xi = (rho, phi)."""
        A = np.zeros((6, 6))
        A[:3, :3] = A[3:, 3:] = self.R
        A[:3, 3:] = skew(self.t) @ self.R
        return A

    def matrix(self) -> Array:
        """(4, 4) homogeneous matrix."""
        M = np.eye(4)
        M[:3, :3] = self.R
        M[:3, 3] = self.t
        return M

    def quat(self) -> Array:
        """(4,) unit quaternion w x y z with w >= 0."""
        # Shepperd's method: divide by the largest component to stay exact near half turns.
        R = self.R
        four = np.array(
            [
                1 + R[0, 0] + R[1, 1] + R[2, 2],
                1 + R[0, 0] - R[1, 1] - R[2, 2],
                1 - R[0, 0] + R[1, 1] - R[2, 2],
                1 - R[0, 0] - R[1, 1] + R[2, 2],
            ]
        )
        products = np.array(
            [
                [four[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
                [R[2, 1] - R[1, 2], four[1], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]],
                [R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], four[2], R[2, 1] + R[1, 2]],
                [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], four[3]],
            ]
        )
        q = products[int(np.argmax(four))]
        q = q / np.linalg.norm(q)
        return q if q[0] >= 0 else -q

    @overload
    def __matmul__(self, other: SE3) -> SE3: ...
    @overload
    def __matmul__(self, other: NDArray[np.floating]) -> Array: ...
    def __matmul__(self, other: SE3 | NDArray[np.floating]) -> SE3 | Array:
        """Compose with a pose, or transform points (..., 3)."""
        if isinstance(other, SE3):
            return SE3(self.R @ other.R, self.R @ other.t + self.t)
        return np.asarray(other) @ self.R.T + self.t

    def flat(self) -> list[float]:
        """The 16 entries of the matrix, row-major, as poses are written to JSON."""
        return [float(x) for x in self.matrix().ravel()]


def rotation_of_quat(wxyz: Array) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4), w x y z."""
    w, x, y, z = np.moveaxis(wxyz, -1, 0)
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.moveaxis(R, (0, 1), (-2, -1))


def nearest_rotation(R: ArrayLike, *, tolerance: float = ROTATION_TOLERANCE) -> Array:
    """The rotation nearest to R (3, 3).

    Args:
        tolerance: largest entry of `R R^T - I`.

    Raises:
        ToolkitError: R is not a rotation to the tolerance (mirrored, scaled, sheared).
    """
    M = _numbers(R)
    if M.shape != (3, 3) or not np.isfinite(M).all():
        raise ToolkitError("a rotation needs 3x3 finite numbers", value=M.tolist())
    if np.linalg.det(M) < 0 or np.abs(M @ M.T - np.eye(3)).max() > tolerance:
        raise ToolkitError(
            "this is not a rotation matrix",
            value=np.round(M, 6).tolist(),
            hint="a rotation has orthonormal rows and determinant +1; scale or reflection inside?",
        )
    if np.abs(M @ M.T - np.eye(3)).max() < 1e-14:
        return M.copy()
    U, _, Vt = np.linalg.svd(M)
    return U @ Vt


def skew(v: ArrayLike) -> Array:
    """(3, 3) cross-product matrix of v (3,)."""
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def so3_exp(phi: ArrayLike) -> Array:
    """Rotation matrix (3, 3) of the rotation vector phi (3,), radians."""
    v = np.asarray(phi, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    S = skew(v)
    if angle < 1e-8:
        return np.eye(3) + S + 0.5 * S @ S
    return np.eye(3) + np.sin(angle) / angle * S + _one_minus_cos(angle) * S @ S


def so3_log(R: ArrayLike) -> Array:
    """Rotation vector (3,), radians, of the rotation matrix R (3, 3); its length is <= pi."""
    q = SE3(np.asarray(R, dtype=np.float64), np.zeros(3)).quat()
    length = float(np.linalg.norm(q[1:]))
    if length < 1e-12:
        return 2 * q[1:]
    return 2 * np.arctan2(length, q[0]) / length * q[1:]


def rotation_angle(R: ArrayLike) -> float:
    """Angle in radians of the rotation matrix R (3, 3), exact also near 0 and pi."""
    return float(np.linalg.norm(so3_log(R)))


def _left_jacobian(phi: Array) -> Array:
    angle = float(np.linalg.norm(phi))
    S = skew(phi)
    # Series near 0: the closed form subtracts nearly equal numbers. The next term is < 1e-15.
    series = 1 / 6 - angle**2 / 120
    cubic = series if angle < 1e-3 else (angle - np.sin(angle)) / angle**3
    half = _one_minus_cos(angle) if angle > 1e-8 else 0.5
    return np.eye(3) + half * S + cubic * S @ S


def _one_minus_cos(angle: float) -> float:
    """(1 - cos a) / a^2, without subtracting nearly equal numbers."""
    return float(0.5 * (np.sin(angle / 2) / (angle / 2)) ** 2)


def _numbers(values: ArrayLike) -> Array:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ToolkitError("a pose needs numbers", value=values) from error
