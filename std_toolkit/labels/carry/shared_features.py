"""Points that the images of two scenes share: SIFT features whose place is known in both.

The place of a feature is triangulated from the frames of its own scene, or, where they have no
baseline, measured by the depth sensor. Labels play no part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.carry.world_relation import SharedPoints
from std_toolkit.poses.features import Features, find_features, match_descriptors
from std_toolkit.scene import Frame, Scene
from std_toolkit.settings import Settings, limit

Array = NDArray[np.float64]
Progress = Callable[[float], None]

_FRAMES = 8
# Of an image, and of those with a known place; SIFT finds the large ones from farther apart.
_MOST_FEATURES, _MOST_KNOWN = 2000, 800
# Smaller images are searched at twice their resolution.
_SMALL_PX = 400 * 300
# Matches whose points are this near in both scenes count once.
_CELL_M = 0.002


@dataclass(frozen=True, kw_only=True)
class SharedFeatureSettings(Settings):
    """When the place of a feature is known."""

    least_angle_deg: float = limit(
        2.0, unit="deg", source="at 0.6 m a pixel of 1 mm is then 30 mm of depth"
    )
    """smallest angle between two rays to a triangulated point"""
    largest_error_px: float = limit(2.0, unit="px", source="camera poses off by 1 mm at 0.6 m")
    """largest reprojection error of a triangulated point"""
    fewest_points: int = limit(30, source="fewest features that must agree")
    """with fewer triangulated points, sensor depth is used"""
    smooth: float = limit(0.02, source="noise of a stereo sensor at 1 m: 5 mm")
    """depth at a pixel counts if that of its neighbours differs by less, relatively"""


@dataclass(frozen=True, eq=False)
class KnownFeatures:
    """Features of one frame with known places.

    Attributes:
        descriptors: (N, 128).
        xyz: (N, 3) world, metres.
        eye: (3,) position of the camera.
    """

    descriptors: NDArray[np.uint8]
    xyz: Array
    eye: Array


@dataclass(frozen=True, eq=False)
class _Picture:
    frame: Frame
    camera: Camera
    T_world_cam: SE3
    features: Features


def shared_features(
    a: Scene, b: Scene, *, progress: Progress = lambda _: None, check: Callable[[], None]
) -> SharedPoints:
    """Match the features of two scenes.

    Args:
        progress: called with the completed fraction, 0 to 1.
        check: called often; raises an error to stop.

    Raises:
        ToolkitError: an image cannot be read, or a scene has neither a baseline nor depth.
    """
    found = []
    for part, scene in enumerate((a, b)):
        pictures = []
        for frame in (frames := spread_frames(scene.registered_frames(), _FRAMES)):
            check()
            pictures.append(_picture(scene, frame))
            progress(0.4 * (part + len(pictures) / len(frames)))
        found.append(known_features(scene, pictures))
    rows_a, rows_b, eyes_a, eyes_b = [], [], [], []
    for number, (one, other) in enumerate(product(*found)):
        check()
        progress(0.8 + 0.2 * number / (len(found[0]) * len(found[1])))
        pairs = match_descriptors(one.descriptors, other.descriptors)
        rows_a.append(one.xyz[pairs[:, 0]])
        rows_b.append(other.xyz[pairs[:, 1]])
        eyes_a.append(np.repeat(one.eye[None], len(pairs), axis=0))
        eyes_b.append(np.repeat(other.eye[None], len(pairs), axis=0))
    points_a, points_b = np.concatenate(rows_a), np.concatenate(rows_b)
    cells = np.floor(np.concatenate([points_a, points_b], axis=1) / _CELL_M).astype(np.int64)
    _, once = np.unique(cells, axis=0, return_index=True)
    once.sort()
    kept_a, kept_b = np.concatenate(eyes_a)[once], np.concatenate(eyes_b)[once]
    return SharedPoints(
        by="features",
        a=points_a[once],
        b=points_b[once],
        eye_a=kept_a.mean(axis=0) if len(once) else np.zeros(3),
        eye_b=kept_b.mean(axis=0) if len(once) else np.zeros(3),
    )


def known_features(scene: Scene, pictures: Sequence[_Picture]) -> list[KnownFeatures]:
    """The features of each picture that have a known place.

    Raises:
        ToolkitError: too few can be triangulated, and there is no depth.
    """
    triangulated = _triangulated(pictures)
    fewest = SharedFeatureSettings.current().fewest_points
    if sum(len(f.xyz) for f in triangulated) >= fewest:
        return triangulated
    measured = [m for p in pictures if (m := _measured(scene, p)) is not None]
    if not measured:
        raise ToolkitError(
            "the places of its features are not known: too few can be triangulated, and there is "
            "no depth",
            path=scene.root,
            hint="relate the scenes by --board or --points",
        )
    return measured


def _triangulated(pictures: Sequence[_Picture]) -> list[KnownFeatures]:
    """Features of each picture, placed with the neighbour in which their rays differ most."""
    limits = SharedFeatureSettings.current()
    xyz = [np.zeros((len(p.features.uv), 3)) for p in pictures]
    angles = [np.zeros(len(p.features.uv)) for p in pictures]
    for i, j in ((i, i + step) for step in (1, 2) for i in range(len(pictures) - step)):
        pairs = match_descriptors(
            pictures[i].features.descriptors, pictures[j].features.descriptors
        )
        if not len(pairs):
            continue
        ends = ((k, pairs[:, side]) for side, k in enumerate((i, j)))
        seen = [(pictures[k], pictures[k].features.uv[rows]) for k, rows in ends]
        points, angle, error = _intersections(seen[0], seen[1])
        for side, k in enumerate((i, j)):
            mine = pairs[:, side]
            better = (error < limits.largest_error_px) & (angle > angles[k][mine])
            xyz[k][mine[better]], angles[k][mine[better]] = points[better], angle[better]
    least = np.deg2rad(limits.least_angle_deg)
    return [
        _largest(picture, np.flatnonzero(angle > least), places)
        for picture, angle, places in zip(pictures, angles, xyz, strict=True)
    ]


def _largest(picture: _Picture, rows: NDArray[np.int64], xyz: Array) -> KnownFeatures:
    """Those of the known features that are largest in the image."""
    features = picture.features
    rows = rows[np.argsort(-features.keypoints[rows, 2], kind="stable")[:_MOST_KNOWN]]
    return KnownFeatures(features.descriptors[rows], xyz[rows], picture.T_world_cam.t)


def _intersections(
    one: tuple[_Picture, Array], other: tuple[_Picture, Array]
) -> tuple[Array, Array, Array]:
    """Where two rays are nearest (N, 3), the angle between them, and the larger pixel error."""
    rays = []
    for picture, uv in (one, other):
        ray = picture.camera.unproject(uv) @ picture.T_world_cam.R.T
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
    (p, q), base = rays, other[0].T_world_cam.t - one[0].T_world_cam.t
    cosine = (p * q).sum(axis=1)
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    along_p = (p @ base - cosine * (q @ base)) / sine2
    along_q = (cosine * (p @ base) - q @ base) / sine2
    ends = [
        one[0].T_world_cam.t + along_p[:, None] * p,
        other[0].T_world_cam.t + along_q[:, None] * q,
    ]
    points = (ends[0] + ends[1]) / 2
    error = np.where((along_p > 0) & (along_q > 0), 0.0, np.inf)
    for picture, uv in (one, other):
        in_camera = picture.T_world_cam.inverse() @ points
        seen = picture.camera.project(np.maximum(in_camera, [-np.inf, -np.inf, 1e-3]))
        error = np.maximum(error, np.linalg.norm(seen - uv, axis=1))
    # Where a lens cannot be inverted nothing is known.
    error = np.where(np.isfinite(error), error, np.inf)
    return np.nan_to_num(points), np.arccos(np.clip(cosine, -1, 1)), error


def _measured(scene: Scene, picture: _Picture) -> KnownFeatures | None:
    """Features where the depth sensor sees a smooth surface; None without depth."""
    depth = scene.read_depth(picture.frame)
    if depth is None:
        return None
    uv = picture.features.uv
    z = depth_at(depth, uv)
    xyz = picture.T_world_cam @ picture.camera.unproject(uv, z)
    return _largest(picture, np.flatnonzero(z > 0), xyz)


def depth_at(depth: NDArray[np.float32], uv: Array) -> Array:
    """Depth (N,) at pixels (N, 2): the median of 3 x 3, metres; 0 at edges and without depth."""
    height, width = depth.shape
    u, v = np.round(uv).astype(np.int64).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    steps = np.arange(-1, 2)
    columns = np.clip(u[:, None, None] + steps[None, None, :], 0, width - 1)
    rows = np.clip(v[:, None, None] + steps[None, :, None], 0, height - 1)
    patch = depth[rows, columns].reshape(len(uv), 9).astype(np.float64)
    patch[patch <= 0] = np.nan
    seen = np.isfinite(patch).sum(axis=1) >= 5
    out = np.zeros(len(uv))
    if seen.any():
        middle = np.nanmedian(patch[seen], axis=1)
        spread = np.nanmax(patch[seen], axis=1) - np.nanmin(patch[seen], axis=1)
        smooth = spread < SharedFeatureSettings.current().smooth * middle
        out[seen] = np.where(smooth, middle, 0.0)
    return np.where(inside, out, 0.0)


def _picture(scene: Scene, frame: Frame) -> _Picture:
    T_world_cam = scene.T_world_cam(frame.id)
    assert T_world_cam is not None
    color = scene.read_color(frame)
    fine = color.shape[0] * color.shape[1] < _SMALL_PX
    features = find_features(color, fine=fine, max_features=_MOST_FEATURES)
    return _Picture(frame, scene.camera(frame), T_world_cam, features)


def spread_frames(frames: Sequence[Frame], most: int) -> list[Frame]:
    """At most `most` frames, evenly spaced over the recording."""
    count = min(len(frames), most)
    return [frames[i] for i in np.linspace(0, len(frames) - 1, count).round().astype(int)]
