"""What photos on the board tell of the object early: whether it moved, and whether it is clear."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.board.board_photos import PhotoCameras
from std_toolkit.scanning.photos.views import View
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Features of one object lie in a box with this margin.
_MARGIN_M = 0.005


@dataclass(frozen=True, kw_only=True)
class RestSettings(Settings):
    """When an object moved between photos, and when the board shows through it."""

    above_m: float = limit(0.008, unit="m", source=NOT_RECORDED)
    """height above the table from which a feature is one of the object"""
    similar_deg: float = limit(35.0, unit="deg", source=NOT_RECORDED)
    """photos from directions within this angle see the same features"""
    largest_error_px: float = limit(4.0, unit="px", source=NOT_RECORDED)
    """largest error of a feature at rest"""
    many: int = limit(15, source=NOT_RECORDED)
    """features that photos of an object at rest share"""
    none: int = limit(3, source=NOT_RECORDED)
    """largest number of features that photos before and after a move share"""
    fewest_pairs: int = limit(4, source=NOT_RECORDED)
    """pairs of photos on either side of a move"""
    share_none: float = limit(0.5, source=NOT_RECORDED)
    """share of the pairs across a move that share no feature, beyond that of pairs on one side"""
    level_deg: float = limit(8.0, unit="deg", source=NOT_RECORDED)
    """photos whose directions differ in height by more share fewer features"""
    same_place: float = limit(0.5, source=NOT_RECORDED)
    """overlap, from above, of the boxes around the features of an object that stayed in its
    place"""
    corners_through: int = limit(4, source=NOT_RECORDED)
    """corners of tags in one photo that show the board through the object"""
    photos_through: int = limit(3, source=NOT_RECORDED)
    """such photos from which an object is clear"""


def check_rest(
    pairs: Sequence[tuple[int, int, Any]],
    uv: Mapping[int, Array],
    poses: Mapping[int, SE3],
    cameras: PhotoCameras,
    names: Sequence[str],
    *,
    reach: tuple[Array, Array],
) -> None:
    """Raise an error if the object moved on the board between two photos.

    Features above the table that two photos share, at one place relative to the board, belong to an
    object at rest. If most photos before some moment share none with those after it, although
    photos from directions as similar share many, the object was moved or turned.

    Args:
        pairs: photo, photo, and (M, 2) indices of matched features.
        uv: pixels (N, 2) of the features by photo.
        poses: T_world_cam by photo, with the table at z = 0.
        cameras: intrinsics.
        names: file names of the photos.
        reach: corners (x, y) of the board, metres; the object stands within them.

    Raises:
        ToolkitError: it moved.
    """
    limits = RestSettings.current()
    ends, points = [], []
    for i, j, matches in pairs:
        if i not in poses or j not in poses or _angle(poses[i], poses[j]) > limits.similar_deg:
            continue
        ends.append((min(i, j), max(i, j)))
        seen = uv[i][matches[:, 0]], uv[j][matches[:, 1]]
        points.append(_shared(*seen, poses[i], poses[j], (cameras.of(i), cameras.of(j)), reach))
    if not ends:
        return
    first, last = np.array(ends).T
    count = np.array([len(p) for p in points])
    level = np.array([_height(poses[i]) - _height(poses[j]) for i, j in ends])
    level = np.abs(level) < limits.level_deg
    found, most = None, limits.share_none
    for k in sorted(poses)[1:]:
        across = np.flatnonzero((first < k) & (last >= k))
        early, late = np.flatnonzero(last < k), np.flatnonzero(first >= k)
        if min(len(across), len(early), len(late)) < limits.fewest_pairs:
            continue
        # Photos beside a plain side of an object share nothing either, with any photo.
        beside = count[early][last[early] == k - 1], count[late][first[late] == k]
        if min(c.max(initial=0) for c in beside) < limits.many:
            continue
        if min(np.median(count[early]), np.median(count[late])) < limits.many:
            continue
        boxes = [_box([points[n] for n in part]) for part in (early, late)]
        none = np.array([
            min(int(((points[n] >= low) & (points[n] <= high)).all(axis=1).sum())
                for low, high in boxes) <= limits.none
            for n in across
        ])  # fmt: skip
        # Photos from two heights may share little although nothing moved. After a move, those from
        # one height share nothing either.
        within = np.concatenate([early, late])
        share = min(
            float(none[level[across] == kind].mean())
            - _mean(count[within[level[within] == kind]] <= limits.none)
            for kind in np.unique(level[across])
        )
        # Between a low and a high round, no pair tells how much photos of an object at rest share:
        # a low box shows them little but its sides, or its top. If it moved, it stands elsewhere.
        if (
            not (level[across].any() or (~level[within]).any())
            and _overlap(*boxes) > limits.same_place
        ):
            continue
        if share >= most and (found is None or share > most):
            found, most = k, share
    if found is not None:
        raise ToolkitError(
            f"the object moved on the board between {names[found - 1]} and {names[found]}",
            hint="photograph it again without touching it on the board, or keep only the photos "
            "before or after the move",
        )


def _box(points: Sequence[Array]) -> tuple[Array, Array]:
    """Corners of a box around nearly all points of an object."""
    together = np.concatenate(points)
    low, high = np.percentile(together, 2, axis=0), np.percentile(together, 98, axis=0)
    return low - _MARGIN_M, high + _MARGIN_M


def _overlap(a: tuple[Array, Array], b: tuple[Array, Array]) -> float:
    """Share of the joined area of two boxes, seen from above, that both have."""
    sides = np.minimum(a[1], b[1])[:2] - np.maximum(a[0], b[0])[:2]
    both = float(np.maximum(sides, 0).prod())
    return both / float(np.prod(a[1][:2] - a[0][:2]) + np.prod(b[1][:2] - b[0][:2]) - both)


def _mean(values: NDArray[np.bool_]) -> float:
    return float(values.mean()) if len(values) else 0.0


def _height(pose: SE3) -> float:
    """Angle of a viewing direction below the horizon in degrees."""
    return float(np.degrees(np.arcsin(np.clip(-pose.R[2, 2], -1, 1))))


def _angle(a: SE3, b: SE3) -> float:
    """Angle between two viewing directions in degrees."""
    return float(np.degrees(np.arccos(np.clip(a.R[:, 2] @ b.R[:, 2], -1, 1))))


def _shared(
    a: Array, b: Array, pose_a: SE3, pose_b: SE3, cameras: tuple[Camera, Camera],
    reach: tuple[Array, Array],
) -> Array:  # fmt: skip
    """Points (N, 3) above the board at which matches (M, 2), (M, 2) meet."""
    limits = RestSettings.current()
    if len(a) == 0:
        return np.zeros((0, 3))
    seen = (pose_a, a, cameras[0]), (pose_b, b, cameras[1])
    rays = [np.asarray(pose.R @ camera.unproject(p).T).T for pose, p, camera in seen]
    d, e = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in rays)
    base = pose_b.t - pose_a.t
    cosine = (d * e).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = ((d @ base) - cosine * (e @ base)) / (1 - cosine**2)
    point = pose_a.t + along[:, None] * d
    low, high = reach
    with np.errstate(invalid="ignore"):
        good = (along > 0) & (point[:, 2] > limits.above_m)
        good &= ((point[:, :2] > low) & (point[:, :2] < high)).all(axis=1)
    for pose, p, camera in seen:
        off = np.linalg.norm(camera.project(pose.inverse() @ point) - p, axis=1)
        good &= np.nan_to_num(off, nan=np.inf) < limits.largest_error_px
    return np.asarray(point[good])


def check_opaque(
    views: Sequence[View], corners: Mapping[str, Array], vertices: Array, faces: NDArray[np.int64]
) -> None:
    """Raise an error if photos show tags of the board through the object.

    Args:
        views: photos.
        corners: pixels (N, 2) of the corners found in each photo, by its name.
        vertices, faces: surface well within the object, world.

    Raises:
        ToolkitError: the object is transparent.
    """
    limits = RestSettings.current()
    caster = RayCaster(vertices, faces)
    through = []
    for view in views:
        uv = corners.get(view.name, np.zeros((0, 2)))
        if len(uv) == 0:
            continue
        rays = np.asarray(view.T_world_cam.R @ view.camera.unproject(uv).T).T
        start = np.broadcast_to(view.centre, rays.shape)
        hit = np.isfinite(caster.cast(np.concatenate([start, rays], axis=1)).distance)
        if hit.sum() >= limits.corners_through:
            through.append(view.name)
    if len(through) >= limits.photos_through:
        raise ToolkitError(
            f"the object is transparent: {len(through)} photos show the board through it",
            value=", ".join(through[:4]),
            hint="spray it matt and photograph it again, or scan it with --revolve if it is a "
            "vessel of revolution",
        )
