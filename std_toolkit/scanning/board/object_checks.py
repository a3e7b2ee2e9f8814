"""What photos on the board tell of the object early: whether it moved, and whether it is clear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.photos.views import Array, View

# Height above the table from which a feature is one of the object.
_ABOVE_M = 0.008
# Photos from directions within this angle see the same features.
_SIMILAR_DEG = 35.0
_LARGEST_ERROR_PX = 4.0
# Features that photos of an object at rest share, and that photos before and after a move share.
_MANY, _NONE = 15, 3
# Pairs of photos before and after a move, and the share of them that share no feature, beyond that
# of pairs on one side of the move.
_LEAST_PAIRS, _SHARE_NONE = 4, 0.5
# Photos whose directions differ in height by more than this share fewer features.
_LEVEL_DEG = 8.0
# Overlap, from above, of the boxes around the features of an object that stayed in its place.
_SAME_PLACE = 0.5
# Features of one object lie in a box with this margin.
_MARGIN_M = 0.005
# Corners of tags in one photo, and photos, that show the board through the object.
_CORNERS_THROUGH, _PHOTOS_THROUGH = 4, 3


def check_rest(
    pairs: Sequence[tuple[int, int, Any]],
    uv: Mapping[int, Array],
    poses: Mapping[int, SE3],
    camera: Camera,
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
        camera: intrinsics.
        names: file names of the photos.
        reach: corners (x, y) of the board, metres; the object stands within them.

    Raises:
        ToolkitError: it moved.
    """
    ends, points = [], []
    for i, j, matches in pairs:
        if i not in poses or j not in poses or _angle(poses[i], poses[j]) > _SIMILAR_DEG:
            continue
        ends.append((min(i, j), max(i, j)))
        points.append(_shared(uv[i][matches[:, 0]], uv[j][matches[:, 1]], poses[i], poses[j],
                              camera, reach))  # fmt: skip
    if not ends:
        return
    first, last = np.array(ends).T
    count = np.array([len(p) for p in points])
    level = np.array([_height(poses[i]) - _height(poses[j]) for i, j in ends])
    level = np.abs(level) < _LEVEL_DEG
    found, most = None, _SHARE_NONE
    for k in sorted(poses)[1:]:
        across = np.flatnonzero((first < k) & (last >= k))
        early, late = np.flatnonzero(last < k), np.flatnonzero(first >= k)
        if min(len(across), len(early), len(late)) < _LEAST_PAIRS:
            continue
        # Photos beside a plain side of an object share nothing either, with any photo.
        beside = count[early][last[early] == k - 1], count[late][first[late] == k]
        if min(c.max(initial=0) for c in beside) < _MANY:
            continue
        if min(np.median(count[early]), np.median(count[late])) < _MANY:
            continue
        boxes = [_box([points[n] for n in part]) for part in (early, late)]
        none = np.array([
            min(int(((points[n] >= low) & (points[n] <= high)).all(axis=1).sum())
                for low, high in boxes) <= _NONE
            for n in across
        ])  # fmt: skip
        # Photos from two heights may share little although nothing moved. After a move, those from
        # one height share nothing either.
        within = np.concatenate([early, late])
        share = min(
            float(none[level[across] == kind].mean())
            - _mean(count[within[level[within] == kind]] <= _NONE)
            for kind in np.unique(level[across])
        )
        # Between a low and a high round, no pair tells how much photos of an object at rest share:
        # a low box shows them little but its sides, or its top. If it moved, it stands elsewhere.
        if not (level[across].any() or (~level[within]).any()) and _overlap(*boxes) > _SAME_PLACE:
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
    a: Array, b: Array, pose_a: SE3, pose_b: SE3, camera: Camera, reach: tuple[Array, Array]
) -> Array:
    """Points (N, 3) above the board at which matches (M, 2), (M, 2) meet."""
    if len(a) == 0:
        return np.zeros((0, 3))
    rays = [np.asarray(pose.R @ camera.unproject(p).T).T for pose, p in ((pose_a, a), (pose_b, b))]
    d, e = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in rays)
    base = pose_b.t - pose_a.t
    cosine = (d * e).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = ((d @ base) - cosine * (e @ base)) / (1 - cosine**2)
    point = pose_a.t + along[:, None] * d
    low, high = reach
    with np.errstate(invalid="ignore"):
        good = (along > 0) & (point[:, 2] > _ABOVE_M)
        good &= ((point[:, :2] > low) & (point[:, :2] < high)).all(axis=1)
    for pose, p in ((pose_a, a), (pose_b, b)):
        off = np.linalg.norm(camera.project(pose.inverse() @ point) - p, axis=1)
        good &= np.nan_to_num(off, nan=np.inf) < _LARGEST_ERROR_PX
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
    caster = RayCaster(vertices, faces)
    through = []
    for view in views:
        uv = corners.get(view.name, np.zeros((0, 2)))
        if len(uv) == 0:
            continue
        rays = np.asarray(view.T_world_cam.R @ view.camera.unproject(uv).T).T
        start = np.broadcast_to(view.centre, rays.shape)
        hit = np.isfinite(caster.cast(np.concatenate([start, rays], axis=1)).distance)
        if hit.sum() >= _CORNERS_THROUGH:
            through.append(view.name)
    if len(through) >= _PHOTOS_THROUGH:
        raise ToolkitError(
            f"the object is transparent: {len(through)} photos show the board through it",
            value=", ".join(through[:4]),
            hint="spray it matt and photograph it again, or scan it with --revolve if it is a "
            "vessel of revolution",
        )
