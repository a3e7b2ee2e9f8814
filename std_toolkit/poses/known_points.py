"""Scale from points of known metric position that are visible in several images.

The unknowns are the scale and the pose of the rigid body of points in the world of the model. The
fit minimises the pixel errors of all views jointly. This weights lateral translation (well
determined) and translation along the line of sight (poorly determined) correctly; a comparison of
poses or distances does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, Similarity, ransac_similarity
from std_toolkit.scene.model import ScaleEstimate

# Huber threshold, pixels, for sub-pixel corners and good annotations.
ROBUST_PX = 2.0
_FOLDS = 12


@dataclass(frozen=True, eq=False)
class KnownView:
    """Points of the body observed in one image.

    Attributes:
        T_cam_world: camera pose, units of the model.
        camera: intrinsics.
        ids: (N,) point ids, the same in every view.
        xyz: (N, 3) points in the body's frame, metres.
        uv: (N, 2) pixels.
        weight: weight of every pixel of this view.
    """

    T_cam_world: SE3
    camera: Camera
    ids: NDArray[np.int64]
    xyz: NDArray[np.float64]
    uv: NDArray[np.float64]
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class BodyFit:
    """Pose of the body and scale of the model.

    Attributes:
        scale: metres per unit of the model.
        T_world_body: pose of the body in the metric world (the model scaled about its origin).
        rms_px: root mean square of the inliers of the weighted residuals.
    """

    scale: float
    T_world_body: SE3
    rms_px: float


def scale_from_known_points(
    views: Sequence[KnownView], *, source: str, note: str, threshold_m: float
) -> ScaleEstimate:
    """Estimate the scale by robust least squares, and its error by a jackknife over the views.

    Args:
        views: at least two, from different positions.
        source: name of the estimate.
        note: description of the measurements; the residual of the fit is appended.
        threshold_m: RANSAC threshold of the initial fit, metres.

    Raises:
        ToolkitError: too few views, or no consistent fit.
    """
    fit = fit_body(views, threshold_m=threshold_m)
    singles = [s for s in (_refit(v, fit) for v in _subsets(views)) if s is not None]
    left_out = [s for s in (_refit(v, fit) for v in _folds(views)) if s is not None]
    n = len(left_out)
    if n == 0:
        raise ToolkitError(
            "the views of known points contradict each other: no subset determines the scale",
            value=f"{len(views)} views",
        )
    variance = (n - 1) / n * float(((np.array(left_out) - np.mean(left_out)) ** 2).sum())
    q1, q3 = np.percentile(singles, [25, 75]) if singles else (fit.scale, fit.scale)
    return ScaleEstimate(
        source=source,
        factor=fit.scale,
        spread=float(q3 - q1) / fit.scale,
        standard_error=float(np.sqrt(variance)) / fit.scale,
        count=sum(len(v.ids) for v in views),
        note=f"{note}; residual {fit.rms_px:.2f} px",
    )


def fit_body(views: Sequence[KnownView], *, threshold_m: float) -> BodyFit:
    """Triangulate the points, fit a similarity, then minimise all pixel errors.

    Raises:
        ToolkitError: fewer than four points in two views, or no consistent similarity.
    """
    _, model, body = triangulate_points(views)
    if len(model) < 4:
        raise ToolkitError(
            "scale from known points needs at least 4 points in at least 2 registered frames",
            value=len(model),
        )
    start, _ = ransac_similarity(model, body, threshold_m=threshold_m)
    return _refine(views, start)


def triangulate_points(
    views: Sequence[KnownView],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Ids (N,) of the points that two views show, their places (N, 3) in the world and the body."""
    rows: dict[int, list[NDArray[np.float64]]] = {}
    known: dict[int, NDArray[np.float64]] = {}
    for view in views:
        P = view.T_cam_world.matrix()[:3]
        xy = view.camera.unproject(view.uv)[:, :2]
        for point, X, (x, y) in zip(view.ids, view.xyz, xy, strict=True):
            rows.setdefault(int(point), []).extend([x * P[2] - P[0], y * P[2] - P[1]])
            known[int(point)] = X
    ids, model, body = [], [], []
    for point, equations in sorted(rows.items()):
        if len(equations) < 4:
            continue
        h = np.linalg.svd(np.array(equations))[2][-1]
        if abs(h[3]) > 1e-12:
            ids.append(point)
            model.append(h[:3] / h[3])
            body.append(known[point])
    shape = (-1, 3)
    return np.array(ids, np.int64), np.array(model).reshape(shape), np.array(body).reshape(shape)


def _refine(views: Sequence[KnownView], start: Similarity) -> BodyFit:
    from scipy.optimize import least_squares

    # body = scale * R @ model + t, so the body in the metric world is at (R.T, -R.T t).
    T0 = SE3(start.R.T, -start.R.T @ start.t)
    weights = np.concatenate([np.full(2 * len(v.ids), np.sqrt(v.weight)) for v in views])

    def unpack(x: NDArray[np.float64]) -> tuple[float, SE3]:
        return start.scale * float(np.exp(x[0])), T0 @ SE3.exp(x[1:])

    def residuals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        scale, T_world_body = unpack(x)
        out = []
        for v in views:
            p = (T_world_body @ v.xyz) @ v.T_cam_world.R.T + scale * v.T_cam_world.t
            # A trial step that puts a point behind the camera must not stop the fit.
            p[:, 2] = np.maximum(p[:, 2], 1e-3)
            out.append((v.camera.project(p) - v.uv).ravel())
        return np.concatenate(out) * weights

    result = least_squares(
        residuals, np.zeros(7), loss="huber", f_scale=ROBUST_PX, x_scale="jac", max_nfev=50
    )
    scale, T_world_body = unpack(result.x)
    r = residuals(result.x).reshape(-1, 2)
    length = np.linalg.norm(r, axis=1)
    kept = length[length < 5 * ROBUST_PX]
    rms = float(np.sqrt((kept**2).mean())) if len(kept) else float("inf")
    return BodyFit(scale, T_world_body, rms)


def _refit(views: Sequence[KnownView], fit: BodyFit) -> float | None:
    R = fit.T_world_body.R.T
    start = Similarity(fit.scale, R, -R @ fit.T_world_body.t)
    scale = _refine(views, start).scale
    return scale if 0.5 < scale / fit.scale < 2 else None


def _folds(views: Sequence[KnownView]) -> list[list[KnownView]]:
    """Jackknife folds: each leaves out one group of views, interleaved over the recording."""
    count = min(_FOLDS, len(views))
    return (
        [[v for i, v in enumerate(views) if i % count != k] for k in range(count)]
        if (len(views) > 2)
        else [list(views)]
    )


def _subsets(views: Sequence[KnownView]) -> list[list[KnownView]]:
    """Small subsets that each determine the scale: all pairs, or a dozen interleaved groups."""
    if len(views) <= 6:
        return [[a, b] for a, b in combinations(views, 2)]
    count = min(_FOLDS, len(views) // 3)
    return [[v for i, v in enumerate(views) if i % count == k] for k in range(count)]
