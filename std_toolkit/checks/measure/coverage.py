"""View directions from which an object was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.contours import mesh_problem
from std_toolkit.geometry.se3 import SE3
from std_toolkit.scene import Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]
Item = TypeVar("Item")

# Views that are compared with all others at a time.
_BLOCK = 256


@dataclass(frozen=True, kw_only=True)
class CoverageSettings(Settings):
    """From where an object must be seen."""

    narrow_deg: float = limit(
        30.0,
        unit="deg",
        source="the error along the view is 1 / tan(angle / 2) times the lateral error, 3.7 "
        "times at 30 degrees",
    )
    """below this largest angle between two views, depth is weakly determined"""
    seen_fraction: float = limit(0.3, source=NOT_RECORDED)
    """an object counts as seen in a frame when this part of it is visible"""


@dataclass(frozen=True)
class Coverage:
    """View directions of one object.

    Attributes:
        frames: number of frames that see it.
        azimuth_span_deg: full turn minus the largest gap in azimuth.
        elevation_min_deg, elevation_max_deg: above the horizontal plane.
        parallax_deg: largest angle between two view directions.
        largest_step_deg: largest azimuth step between neighbouring views inside the span.
    """

    frames: int
    azimuth_span_deg: float
    elevation_min_deg: float
    elevation_max_deg: float
    parallax_deg: float
    largest_step_deg: float


def spread(items: Sequence[Item], count: int) -> list[Item]:
    """At most `count` items, evenly spaced, with the first and the last; 0 means all."""
    if count == 0 or len(items) <= count:
        return list(items)
    return [items[i] for i in np.unique(np.linspace(0, len(items) - 1, count).round().astype(int))]


def scene_up(poses: list[SE3], points: Array | None) -> Array:
    """Estimate the up direction of the world, a unit vector (3,).

    The normal of the dominant plane of the points (a table) if it agrees with the orientation of
    the cameras, otherwise the mean of the cameras' up directions.
    """
    if not poses:
        return np.array([0.0, -1.0, 0.0])
    held = _mean_direction(poses, [0.0, -1.0, 0.0])
    if points is None or len(points) < 100:
        return held
    normal = _plane_normal(points)
    if normal is None:
        return held
    centre = np.median(points, axis=0)
    towards = np.mean([T.t for T in poses], axis=0) - centre
    normal = normal if normal @ towards > 0 else -normal
    return normal if normal @ seen_from_above(poses) > np.cos(np.deg2rad(50)) else held


def seen_from_above(poses: Sequence[SE3]) -> Array:
    """Where the normal of a table is, (3,), if it is seen from above.

    That is between the cameras' up and backward directions.

    Args:
        poses: T_world_cam, at least one.
    """
    up, back = (_mean_direction(poses, d) for d in ([0.0, -1.0, 0.0], [0.0, 0.0, -1.0]))
    return _unit(up + back)


def _mean_direction(poses: Sequence[SE3], direction: list[float]) -> Array:
    """Mean over the cameras of a direction in their frames, as a unit vector in the world."""
    return _unit(np.mean([T.R @ direction for T in poses], axis=0))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))


def directions(
    centre: NDArray[np.floating], cameras: NDArray[np.floating], up: Array, ahead: Array
) -> tuple[Array, Array]:
    """Azimuth and elevation (N,) in degrees of cameras (N, 3) seen from a point.

    Azimuth is 0 towards `ahead` and increases counter-clockwise seen from above.
    """
    x_axis = ahead - (ahead @ up) * up
    if np.linalg.norm(x_axis) < 1e-9:
        x_axis = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    x_axis = x_axis / np.linalg.norm(x_axis)
    y_axis = np.cross(up, x_axis)
    d = np.asarray(cameras, dtype=np.float64) - centre
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    azimuth = np.degrees(np.arctan2(d @ y_axis, d @ x_axis)) % 360
    return azimuth, np.degrees(np.arcsin(np.clip(d @ up, -1, 1)))


def measure_coverage(azimuth_deg: Array, elevation_deg: Array) -> Coverage | None:
    """Spans and gaps of view directions (N,); None without any."""
    if len(azimuth_deg) == 0:
        return None
    ordered = np.sort(azimuth_deg)
    gaps = np.diff(np.concatenate([ordered, [ordered[0] + 360]]))
    widest = int(gaps.argmax())
    inner = np.delete(gaps, widest)
    a, e = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    d = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    # In blocks: all pairs of 10,000 views would take 0.8 GB.
    blocks = np.array_split(d, max(len(d) // _BLOCK, 1))
    least = min(float((block @ d.T).min()) for block in blocks)
    return Coverage(
        len(azimuth_deg),
        float(360 - gaps[widest]),
        float(elevation_deg.min()),
        float(elevation_deg.max()),
        float(np.degrees(np.arccos(np.clip(least, -1, 1)))),
        float(inner.max()) if len(inner) else 0.0,
    )


def view_directions(
    scene: Scene, object_id: int, frames: Sequence[int], up: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Azimuth and elevation (N,) in degrees from which frames see an object; None without any.

    Azimuth 0 is the direction from the centre of the labelled objects to the camera of the first
    registered frame, the same for all objects.
    """
    T_world_obj = scene.T_world_obj(object_id)
    cameras = [T for f in frames if (T := scene.T_world_cam(f)) is not None]
    model = scene.objects.object(object_id).model
    if T_world_obj is None or not cameras or mesh_problem(scene, model) is not None:
        return None
    first = scene.T_world_cam(scene.registered_frames()[0].id)
    labelled = [T for o in scene.objects.objects if (T := scene.T_world_obj(o.id)) is not None]
    assert first is not None
    middle = np.mean([T.t for T in labelled], axis=0)
    return directions(
        _centre(scene, object_id, T_world_obj), _positions(cameras), up, first.t - middle
    )


def _centre(scene: Scene, object_id: int, T_world_obj: SE3) -> NDArray[np.float64]:
    bounds = np.asarray(scene.mesh(scene.objects.object(object_id).model).bounds)
    return T_world_obj @ bounds.mean(axis=0)


def _positions(poses: Sequence[SE3]) -> NDArray[np.float64]:
    return np.stack([T.t for T in poses])


def _plane_normal(points: Array) -> Array | None:
    """Normal of the plane with most inliers, if these are at least a fifth of the points."""
    rng = np.random.default_rng(0)
    sample = points if len(points) <= 4000 else points[rng.choice(len(points), 4000, replace=False)]
    extent = float(np.median(np.linalg.norm(sample - np.median(sample, axis=0), axis=1)))
    tolerance = 0.02 * max(extent, 1e-6)
    best, best_count = None, 0
    for _ in range(300):
        a, b, c = sample[rng.choice(len(sample), 3, replace=False)]
        n = np.cross(b - a, c - a)
        length = float(np.linalg.norm(n))
        if length < 1e-12:
            continue
        near = np.abs((sample - a) @ (n / length)) < tolerance
        if near.sum() > best_count:
            best, best_count = near, int(near.sum())
    if best is None or best_count < 0.2 * len(sample):
        return None
    plane = sample[best]
    return np.asarray(np.linalg.svd(plane - plane.mean(axis=0), full_matrices=False)[2][2])
