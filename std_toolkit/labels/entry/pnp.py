"""Object pose from 2D-3D correspondences: RANSAC over P3P, then Levenberg-Marquardt in pixels.

Files of clicked 2D-3D correspondences: CSV or JSON of u, v, x, y, z.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from math import comb
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.mesh import UNITS_IN_M
from std_toolkit.geometry.se3 import SE3, rotation_angle, skew, so3_exp
from std_toolkit.io.documents import read_document
from std_toolkit.io.foreign_files import csv_rows
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Clicks are rarely more accurate than this; smaller residuals do not measure the noise.
CLICK_NOISE_PX = 0.5


COLUMNS = ("u", "v", "x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class PnpSettings(Settings):
    """When correspondences determine a pose."""

    largest_angle_std: float = limit(np.deg2rad(20), unit="rad", source=NOT_RECORDED)
    """with a larger deviation, a direction of the pose is not determined"""
    distinct_angle: float = limit(np.deg2rad(5), unit="rad", source=NOT_RECORDED)
    """two poses that differ by more are different solutions, not noise"""


@dataclass(frozen=True, eq=False)
class PnPResult:
    """Pose of an object from correspondences.

    Attributes:
        T_cam_obj: object frame to camera frame, metres.
        inliers: (N,) bool.
        residuals_px: (N,) distance in pixels between clicked and projected point; inf behind the
            camera.
        rmse_px: root mean square of the inliers' residuals.
        covariance: (6, 6) of a right perturbation `T_cam_obj @ SE3.exp(xi)`, for the noise of the
            residuals but at least `CLICK_NOISE_PX`.
    """

    T_cam_obj: SE3
    inliers: NDArray[np.bool_]
    residuals_px: Array
    rmse_px: float
    covariance: Array


def solve_pnp(
    points_obj: NDArray[np.floating],
    pixels: NDArray[np.floating],
    camera: Camera,
    *,
    threshold_px: float = 4.0,
    max_samples: int = 500,
    seed: int = 0,
) -> PnPResult:
    """Pose of an object from clicked points, sub-pixel, robust to outliers.

    Args:
        points_obj: (N, 3) points in the mesh frame, metres.
        pixels: (N, 2) their pixels (u, v), pixel centres at integers, lens distortion included.
        camera: intrinsics.
        threshold_px: largest residual of an inlier.
        max_samples: largest number of triples to try; if there are fewer, all are tried.
        seed: seed of the random triples.

    Returns:
        The pose refitted to all inliers.

    Raises:
        ToolkitError: fewer than four points, points on a line or at one position, fewer than four
            (or half of the) points that agree on a pose, or two different poses that explain the
            points equally well.
    """
    limits = PnpSettings.current()
    X, uv = _checked(points_obj, pixels)
    order = _ranked_hypotheses(X, uv, camera, threshold_px, max_samples, seed)
    if not order:
        raise ToolkitError(
            "no pose puts the points in front of the camera", value=f"{len(X)} points"
        )
    refined: list[tuple[float, SE3, NDArray[np.bool_]]] = []
    for pose in order:
        pose, inliers = _refit(pose, X, uv, camera, threshold_px)
        refined.append((_robust_cost(_distances(pose, X, uv, camera), threshold_px), pose, inliers))
    refined.sort(key=lambda row: row[0])
    cost, pose, inliers = refined[0]
    residuals = _distances(pose, X, uv, camera)
    if inliers.sum() < max(4, len(X) / 2):
        raise ToolkitError(
            f"only {int(inliers.sum())} of {len(X)} correspondences agree on a pose",
            value=f"residuals {np.round(residuals, 1).tolist()} px",
            hint=f"at least 4 and half of them must fit within {threshold_px} px: "
            "check the order of the points, their unit, and the intrinsics",
        )
    rmse = float(np.sqrt((residuals[inliers] ** 2).mean()))
    # The noise of the fit; an alternative within it is as likely as the best solution.
    freedom = max(2 * int(inliers.sum()) - 6, 1)
    variance = max(float((residuals[inliers] ** 2).sum() / freedom), CLICK_NOISE_PX**2)
    for rival_cost, rival, _ in refined[1:]:
        if (
            rotation_angle(pose.R.T @ rival.R) > limits.distinct_angle
            and rival_cost - cost < 9 * variance
        ):
            raise ToolkitError(
                "two different poses explain the correspondences equally well",
                value=f"{np.rad2deg(rotation_angle(pose.R.T @ rival.R)):.0f} degrees apart",
                hint="add points that are outside the plane of the others or further apart",
            )
    J = _jacobian(pose, X[inliers], camera)
    information = J.T @ J / variance
    covariance = _inverse_or_refuse(information)
    return PnPResult(pose, inliers, residuals, rmse, covariance)


def _checked(points_obj: NDArray[np.floating], pixels: NDArray[np.floating]) -> tuple[Array, Array]:
    X = np.asarray(points_obj, dtype=np.float64)
    uv = np.asarray(pixels, dtype=np.float64)
    if X.ndim != 2 or X.shape[1:] != (3,) or uv.shape != (len(X), 2):
        raise ToolkitError(
            "correspondences need points (N, 3) and pixels (N, 2)", value=(X.shape, uv.shape)
        )
    if len(X) < 4:
        raise ToolkitError(
            "a pose needs at least 4 correspondences (3 give up to four solutions)", value=len(X)
        )
    if not (np.isfinite(X).all() and np.isfinite(uv).all()):
        raise ToolkitError("a correspondence holds a number that is not finite")
    for values, what in ((X, "points on the object"), (uv, "pixels")):
        spread = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
        if spread[1] <= 0.02 * max(spread[0], 1e-12):
            raise ToolkitError(
                f"the {what} are on a line or at one position: the pose is not determined",
                hint="choose points that are spread over the object",
            )
    return X, uv


def _ranked_hypotheses(
    X: Array, uv: Array, camera: Camera, threshold_px: float, max_samples: int, seed: int
) -> list[SE3]:
    """The best pose of every cluster of P3P solutions, best first, at most six."""
    limits = PnpSettings.current()
    rays = camera.unproject(uv)[:, :2]
    scored: list[tuple[float, SE3]] = []
    for sample in _triples(len(X), max_samples, seed):
        found, rvecs, tvecs = cv2.solveP3P(
            X[sample], rays[sample], np.eye(3), None, flags=cv2.SOLVEPNP_AP3P
        )
        for rvec, tvec in zip(rvecs, tvecs, strict=True) if found else ():
            if not (np.isfinite(rvec).all() and np.isfinite(tvec).all()):
                continue
            pose = SE3(so3_exp(np.ravel(rvec)), np.asarray(tvec, dtype=np.float64).reshape(3))
            scored.append((_robust_cost(_distances(pose, X, uv, camera), threshold_px), pose))
    scored.sort(key=lambda row: row[0])
    kept: list[SE3] = []
    for _, pose in scored:
        if all(rotation_angle(pose.R.T @ other.R) > limits.distinct_angle for other in kept):
            kept.append(pose)
        if len(kept) == 6:
            break
    return kept


def _triples(count: int, limit: int, seed: int) -> Iterator[list[int]]:
    if comb(count, 3) <= limit:
        yield from (list(c) for c in combinations(range(count), 3))
        return
    rng = np.random.default_rng(seed)
    for _ in range(limit):
        yield rng.choice(count, 3, replace=False).tolist()


def _distances(pose: SE3, X: Array, uv: Array, camera: Camera) -> Array:
    d = np.linalg.norm(camera.project(pose @ X) - uv, axis=1)
    return np.where(np.isfinite(d), d, np.inf)


def _robust_cost(distances: Array, threshold_px: float) -> float:
    return float((np.minimum(distances, threshold_px) ** 2).sum())


def _refit(
    pose: SE3, X: Array, uv: Array, camera: Camera, threshold_px: float
) -> tuple[SE3, NDArray[np.bool_]]:
    """Least squares over the inliers until their set is stable."""
    # Hypotheses from three noisy clicks are rough: the first inlier threshold is large.
    inliers = _distances(pose, X, uv, camera) < 3 * threshold_px
    for _ in range(10):
        if inliers.sum() < 4:
            break
        pose = _levenberg_marquardt(pose, X[inliers], uv[inliers], camera)
        now = _distances(pose, X, uv, camera) < threshold_px
        if (now == inliers).all():
            break
        inliers = now
    return pose, _distances(pose, X, uv, camera) < threshold_px


def _levenberg_marquardt(pose: SE3, X: Array, uv: Array, camera: Camera) -> SE3:
    damping = 1e-4
    error = camera.project(pose @ X) - uv
    if not np.isfinite(error).all():
        return pose
    cost = float((error**2).sum())
    for _ in range(50):
        J = _jacobian(pose, X, camera)
        A, b = J.T @ J, J.T @ error.ravel()
        step = np.linalg.lstsq(A + damping * np.diag(np.diag(A)), -b, rcond=None)[0]
        trial = pose @ SE3.exp(step)
        trial_error = camera.project(trial @ X) - uv
        trial_cost = float((trial_error**2).sum())
        if np.isfinite(trial_cost) and trial_cost < cost:
            done = cost - trial_cost < 1e-12 * (1 + cost)
            pose, error, cost, damping = trial, trial_error, trial_cost, damping / 5
            if done:
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    return pose


def _jacobian(pose: SE3, X: Array, camera: Camera) -> Array:
    """(2N, 6) derivative of the pixels by a right perturbation of the pose."""
    p = pose @ X
    # The derivative of the distortion model is numerical, accurate to 1e-7 px.
    h = 1e-6
    d_pixel = np.stack(
        [(camera.project(p + e) - camera.project(p - e)) / (2 * h) for e in np.eye(3) * h],
        axis=-1,
    )
    d_point = np.stack([np.hstack([pose.R, -pose.R @ skew(x)]) for x in X])
    return (d_pixel @ d_point).reshape(-1, 6)


def _inverse_or_refuse(information: Array) -> Array:
    values, vectors = np.linalg.eigh(information[3:, 3:] - _schur(information))
    if values[0] <= 0 or 1 / np.sqrt(values[0]) > PnpSettings.current().largest_angle_std:
        axis = np.round(vectors[:, 0], 2).tolist()
        raise ToolkitError(
            "the correspondences do not determine the rotation",
            value=f"about object axis {axis}",
            hint="choose points that are spread over the object, also in depth",
        )
    return np.asarray(np.linalg.inv(information), dtype=np.float64)


def _schur(information: Array) -> Array:
    t, r = slice(0, 3), slice(3, 6)
    solved = np.linalg.lstsq(information[t, t], information[t, r], rcond=None)[0]
    return np.asarray(information[r, t] @ solved, dtype=np.float64)


def read_correspondences(
    path: Path | str, *, unit: str = "m"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (N, 3) in metres, mesh frame, and pixels (N, 2) of a correspondence file.

    CSV: a header with the columns u, v, x, y, z in any order (further columns are ignored), or
    five numbers per line without a header. JSON: a list of [u, v, x, y, z] or of objects with
    those keys.

    Args:
        unit: unit of x, y, z: "m", "cm" or "mm".

    Raises:
        ToolkitError: unreadable, a column missing, or a value that is not a finite number.
    """
    path = Path(path)
    if unit not in UNITS_IN_M:
        raise ToolkitError("unknown unit", path=path, value=unit, hint="one of m, cm, mm")
    rows = _json_rows(path) if path.suffix.lower() == ".json" else _csv_rows(path)
    if not rows:
        raise ToolkitError("the file has no correspondences", path=path)
    table = np.array(rows, dtype=np.float64)
    if not np.isfinite(table).all():
        raise ToolkitError("a correspondence holds a number that is not finite", path=path)
    return table[:, 2:] * UNITS_IN_M[unit], table[:, :2]


def _csv_rows(path: Path) -> list[list[float]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ToolkitError(f"cannot read the correspondences: {error}", path=path) from error
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        return []
    columns = [c.strip().lower() for c in next(csv_rows(lines[:1], path))]
    if set(COLUMNS) <= set(columns):
        order, lines, first = [columns.index(c) for c in COLUMNS], lines[1:], 2
    elif len(columns) == len(COLUMNS) and _is_number(columns[0]):
        order, first = list(range(5)), 1
    else:
        raise ToolkitError(
            "a correspondence file needs the columns u, v, x, y, z", path=path, value=columns
        )
    return [
        _numbers([row[i] for i in order] if len(row) > max(order) else row, path, f"row {n}")
        for n, row in enumerate(csv_rows(lines, path, first=first), start=first)
    ]


def _json_rows(path: Path) -> list[list[float]]:
    document = read_document(path, list[list[float] | dict[str, float]])
    rows = []
    for i, row in enumerate(document):
        if isinstance(row, dict):
            missing = [c for c in COLUMNS if c not in row]
            if missing:
                raise ToolkitError("a key is missing", path=path, field=f"[{i}]", value=missing)
            row = [row[c] for c in COLUMNS]
        rows.append(_numbers(row, path, f"[{i}]"))
    return rows


def _numbers(row: list, path: Path, field: str) -> list[float]:
    if len(row) != len(COLUMNS) or not all(_is_number(x) for x in row):
        raise ToolkitError(
            "a correspondence needs five numbers: u, v, x, y, z", path=path, field=field, value=row
        )
    return [float(x) for x in row]


def _is_number(text: object) -> bool:
    try:
        float(text)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return False
    return True
