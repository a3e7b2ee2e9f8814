"""Whether a camera pose agrees with the surroundings: points of a frame seen in its neighbours.

Points that two neighbours and the frame have in common are triangulated from the neighbours. The
pose of the frame is wrong if another pose explains many of these points that it does not explain.
Labelled objects are left out: an object that moved says nothing of the camera.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.contours import LabelCaster
from std_toolkit.checks.measure.shared_errors import seen_errors
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.se3 import so3_log
from std_toolkit.scene import Frame, Scene
from std_toolkit.settings import Settings, limit

_MOST_FEATURES = 800
# Images are matched at most this wide: more pixels give no more places on a table.
_LARGEST_WIDTH = 960
_NEIGHBOURS = 3


@dataclass(frozen=True, kw_only=True)
class ScenePointSettings(Settings):
    """When points of the surroundings tell whether a camera pose is right."""

    ratio: float = limit(0.8, source="Lowe, IJCV 2004")
    """distance of a match to that of the next best one"""
    fewest_points: int = limit(15, source="six are needed for a pose; wrong matches agree on few")
    """points that a pose explains"""
    inlier_px: float = limit(
        3.0, unit="px", source="places of SIFT features at 640 pixels, and noise of the neighbours"
    )
    """largest error of a point that a pose explains"""
    right: float = limit(
        0.6, source="set on seed 1: right poses explain 99 %, wrong ones up to 21 %"
    )
    """a pose that explains this part of what the best one explains is right"""
    wrong: float = limit(
        0.35, source="set on seed 1: right poses explain 99 %, wrong ones up to 21 %"
    )
    """one that explains less is wrong"""
    smallest_mm: float = limit(
        6.0, unit="mm", source="poses from structure from motion have errors of up to 4 mm"
    )
    """smallest displacement of the points across the view that is a fault"""
    stated_deviations: float = limit(
        4.0, unit="deviations", source="the neighbours, which give the points, err as well"
    )
    """the same in units of what the stated errors of the camera poses move the points by"""
    baseline: float = limit(
        0.06, source="of cameras 2 deg apart that err by 0.1 deg, points are 4 % too near or far"
    )
    """smallest distance of neighbours from each other, in parts of that to the objects"""


@dataclass(frozen=True)
class CameraEvidence:
    """What the surroundings say of one camera pose.

    Attributes:
        verdict: "unknown" without enough points.
        points: number of points that the best pose explains.
        explained: number of these that the filed pose explains.
        mm: distance between the two camera positions; 0 unless the pose is wrong.
        deg: angle between them.
    """

    verdict: Literal["right", "wrong", "unknown"]
    points: int = 0
    explained: int = 0
    mm: float = 0.0
    deg: float = 0.0


@dataclass(frozen=True, eq=False)
class _Picture:
    """Features of one image: (N, 2) undistorted rays, (N, 128) descriptors."""

    camera: Camera
    T_world_cam: SE3
    rays: Array
    descriptors: NDArray[np.float32]


class ScenePoints:
    """Camera poses of single frames against the surroundings; features are kept.

    Args:
        scene: the scene.
        caster: its labelled objects, which are left out.
    """

    def __init__(self, scene: Scene, caster: LabelCaster) -> None:
        self.scene, self.caster = scene, caster
        self.order = scene.registered_frames()
        self._pictures: dict[int, _Picture | None] = {}

    def judge(self, frame: int, doubtful: Collection[int]) -> CameraEvidence:
        """The evidence on one frame from neighbours that are not in doubt themselves.

        Args:
            frame: id of the frame.
            doubtful: ids of frames whose pose may be wrong.
        """
        ids = [f.id for f in self.order]
        here = self._picture(self.order[ids.index(frame)])
        if here is None:
            return CameraEvidence("unknown")
        at = ids.index(frame)
        near = sorted(
            (k for k, i in enumerate(ids) if i != frame and i not in doubtful),
            key=lambda k: abs(k - at),
        )
        others = self._neighbours(here, near)
        points, pixels = self._common_points(here, others)
        return _compare(here, points, pixels, self._stated_mm(frame, points))

    def _neighbours(self, here: _Picture, near: Sequence[int]) -> list[_Picture]:
        """The nearest pictures that are some way apart from each other."""
        corners = np.concatenate([self.caster.corners[i] for i in self.caster.object_ids])
        distance = float(np.linalg.norm(corners.mean(axis=0) - here.T_world_cam.t))
        apart = ScenePointSettings.current().baseline * distance
        found: list[_Picture] = []
        for k in near:
            pose = self.scene.T_world_cam(self.order[k].id)
            if pose is None or any(np.linalg.norm(pose.t - p.T_world_cam.t) < apart for p in found):
                continue
            picture = self._picture(self.order[k])
            if picture is not None:
                found.append(picture)
            if len(found) == _NEIGHBOURS:
                break
        return found

    def _stated_mm(self, frame: int, points: Array) -> float:
        """Deviation of the place of the points by the stated error of a camera pose."""
        if not len(points):
            return 0.0
        (covariance,) = seen_errors(self.scene, [frame], np.median(points, axis=0))
        return 1000 * float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))

    def _picture(self, frame: Frame) -> _Picture | None:
        if frame.id not in self._pictures:
            self._pictures[frame.id] = self._read(frame)
        return self._pictures[frame.id]

    def _read(self, frame: Frame) -> _Picture | None:
        T_world_cam = self.scene.T_world_cam(frame.id)
        try:
            image = self.scene.read_color(frame)
        except ToolkitError:
            return None
        if T_world_cam is None:
            return None
        camera = self.scene.camera(frame)
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        free = np.full(grey.shape, 255, np.uint8)
        for i in self.caster.object_ids:
            window = self.caster.window(i, camera, T_world_cam)
            if window is not None:
                x0, y0, x1, y1 = window
                inside = self.caster.within(i, camera, T_world_cam, window)
                free[y0:y1, x0:x1][inside] = 0
        scale = min(1.0, _LARGEST_WIDTH / camera.width)
        if scale < 1:
            size = round(scale * camera.width), round(scale * camera.height)
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
            free = np.asarray(cv2.resize(free, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        sift = cv2.SIFT_create(nfeatures=_MOST_FEATURES)  # type: ignore[attr-defined]
        found, descriptors = sift.detectAndCompute(grey, free)
        if descriptors is None or len(found) < 8:
            return None
        uv = (np.array([p.pt for p in found]) + 0.5) / scale - 0.5
        d = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
        return _Picture(camera, T_world_cam, camera.unproject(uv)[:, :2], d.astype(np.float32))

    def _common_points(self, here: _Picture, others: Sequence[_Picture]) -> tuple[Array, Array]:
        """(N, 3) points in the world from two neighbours or more, and (N, 2) their rays here."""
        limits = ScenePointSettings.current()
        rows: dict[int, list[tuple[_Picture, Array]]] = {}
        for other in others:
            for a, b in _matches(here.descriptors, other.descriptors):
                rows.setdefault(int(a), []).append((other, other.rays[b]))
        points, rays = [], []
        for a, views in rows.items():
            if len(views) < 2:
                continue
            X = _triangulate(views)
            if X is None:
                continue
            errors = [_error_px(X[None], r[None], p, p.T_world_cam)[0] for p, r in views]
            if max(errors) < limits.inlier_px:
                points.append(X)
                rays.append(here.rays[a])
        return np.array(points).reshape(-1, 3), np.array(rays).reshape(-1, 2)


def _matches(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.intp]:
    """(M, 2) mutual nearest neighbours that pass the ratio test."""
    limits = ScenePointSettings.current()
    unlike = 2 - 2 * (a @ b.T)
    best = unlike.argmin(axis=1)
    rows = np.arange(len(a))
    nearest = unlike[rows, best]
    mutual = unlike.argmin(axis=0)[best] == rows
    unlike[rows, best] = np.inf
    good = mutual & (nearest < limits.ratio**2 * unlike.min(axis=1))
    return np.stack([rows[good], best[good]], axis=1)


def _triangulate(views: Sequence[tuple[_Picture, Array]]) -> Array | None:
    equations = []
    for picture, (x, y) in views:
        P = picture.T_world_cam.inverse().matrix()[:3]
        equations += [x * P[2] - P[0], y * P[2] - P[1]]
    h = np.linalg.svd(np.array(equations))[2][-1]
    return None if abs(h[3]) < 1e-9 else np.asarray(h[:3] / h[3])


def _error_px(points: Array, rays: Array, picture: _Picture, T_world_cam: SE3) -> Array:
    """Distances in px between points (N, 3) in the world and their rays (N, 2)."""
    p = T_world_cam.inverse() @ points
    z = np.where(p[:, 2] > 1e-6, p[:, 2], np.nan)
    error = np.linalg.norm(p[:, :2] / z[:, None] - rays, axis=1) * picture.camera.fx
    return np.nan_to_num(error, nan=np.inf)


def _compare(here: _Picture, points: Array, rays: Array, stated_mm: float) -> CameraEvidence:
    limits = ScenePointSettings.current()
    if len(points) < limits.fewest_points:
        return CameraEvidence("unknown", len(points))
    filed = _error_px(points, rays, here, here.T_world_cam) < limits.inlier_px
    best = here.T_world_cam
    cv2.setRNGSeed(0)
    done, rvec, tvec, _ = cv2.solvePnPRansac(
        points,
        rays,
        np.eye(3),
        None,
        iterationsCount=300,
        reprojectionError=limits.inlier_px / here.camera.fx,
        flags=cv2.SOLVEPNP_EPNP,
    )
    explained = int(filed.sum())
    count = explained
    if done:
        R, _ = cv2.Rodrigues(rvec)
        best = SE3.from_matrix(np.vstack([np.column_stack([R, tvec]), [0, 0, 0, 1]])).inverse()
        count = max(count, int((_error_px(points, rays, here, best) < limits.inlier_px).sum()))
    if count < limits.fewest_points:
        return CameraEvidence("unknown", count, explained)
    if explained >= limits.right * count:
        return CameraEvidence("right", count, explained)
    mm = 1000 * float(np.linalg.norm(best.t - here.T_world_cam.t))
    deg = float(np.rad2deg(np.linalg.norm(so3_log(best.R.T @ here.T_world_cam.R))))
    depth = (here.T_world_cam.inverse() @ points)[:, 2]
    error = _error_px(points, rays, here, here.T_world_cam) / here.camera.fx * depth
    least = max(limits.smallest_mm, limits.stated_deviations * stated_mm)
    if explained < limits.wrong * count and 1000 * np.median(error) >= least:
        return CameraEvidence("wrong", count, explained, mm, deg)
    return CameraEvidence("unknown", count, explained)
