"""Table from placed objects: the plane on which most of them stand, and scores of planes.

The score of a plane as support distinguishes the table from a wall, the floor or the side of a
box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Standard deviations of height and slope of manual labels relative to their support.
_UNEVEN_M = 0.006

_SLANT = np.radians(6.0)


@dataclass(frozen=True, kw_only=True)
class StandingSettings(Settings):
    """Which objects stand on a plane, and which planes are a table."""

    likely: float = limit(0.2, source=NOT_RECORDED)
    """smallest likelihood, relative to an exact fit, of an object that stands on the plane"""
    cut_m: float = limit(0.015, unit="m", source=NOT_RECORDED)
    """an object that reaches deeper below a plane is cut by it"""
    touches_m: float = limit(0.0015, unit="m", source=NOT_RECORDED)
    """points of an object this near to its lowest one touch the plane"""
    wide_m: float = limit(
        0.03,
        unit="m",
        source="with a smaller spread, contacts alone do not determine the slope",
    )
    """smallest spread of the contacts from which the slope is taken"""
    meets_m: float = limit(0.015, unit="m", source=NOT_RECORDED)
    """largest distance of the lowest point of an object that stands on a plane"""
    sensor_bias: float = limit(0.02, source=NOT_RECORDED)
    """added to `meets_m`, as a fraction of the height of the camera"""
    upright: float = limit(0.15, source=NOT_RECORDED)
    """cosine between the normal and the upward direction of the image: a table is above"""
    sideways: float = limit(-0.15, source=NOT_RECORDED)
    """below this cosine, the normal points down in the image"""
    edge_on: float = limit(0.15, source="recordings do not show a table edge-on")
    """smallest sine of the viewing angle to a table"""


@dataclass(frozen=True, eq=False)
class CommonSupport:
    """A plane `normal . p + offset = 0` under some objects.

    Attributes:
        contacts: (N, 3) lowest points of the objects that stand on it.
        standing: names of these objects.
        rms_m: root mean square of the distances of the contacts, metres.
        upright: mean cosine between the normal and the upward direction of the images.
    """

    normal: Array
    offset: float
    contacts: Array
    standing: tuple[str, ...]
    rms_m: float
    upright: float


def common_support(objects: Sequence[PlacedObject], cameras: Cameras) -> CommonSupport | None:
    """Return the plane on which most objects stand; None if cameras see none from above."""
    limits = StandingSettings.current()
    best: tuple[float, Array, list[PlacedObject]] | None = None
    for obj in objects:
        faces = obj.solid.resting
        for down, steady in zip(faces.down, faces.steady, strict=True):
            normal = -(obj.T_frame_obj.R @ down)
            hull = obj.T_frame_obj @ obj.solid.hull
            offset = -float((hull @ normal).min())
            foot = hull[(hull @ normal).argmin()]
            view = score_support(normal, offset, 1.0, foot, cameras, ())
            if view.score == 0 or view.normal @ normal < 0:
                continue
            likely, cut = _standing(objects, normal, offset)
            # Among planes with equally many objects, prefer the one that the cameras see from
            # above, then the one on which the object is more stable.
            merit = float(likely.sum()) - 2 * cut + 0.6 * view.score + 0.3 * min(float(steady), 1.0)
            if best is None or merit > best[0]:
                standing = [t for t, p in zip(objects, likely, strict=True) if p > limits.likely]
                best = merit, normal, standing
    if best is None or not best[2]:
        return None
    return _fitted(best[1], best[2], cameras)


def _standing(objects: Sequence[PlacedObject], normal: Array, offset: float) -> tuple[Array, int]:
    """Likelihood of each object to stand on a plane, 0 to 1, and number of objects it cuts."""
    likely, cut = np.zeros(len(objects)), 0
    for i, obj in enumerate(objects):
        low = float((obj.T_frame_obj @ obj.solid.hull @ normal + offset).min())
        _, tilt = obj.solid.resting.nearest(-obj.T_frame_obj.R.T @ normal)
        likely[i] = np.exp(-0.5 * ((low / _UNEVEN_M) ** 2 + (tilt / _SLANT) ** 2))
        cut += low < -StandingSettings.current().cut_m
    return likely, cut


def _fitted(normal: Array, standing: Sequence[PlacedObject], cameras: Cameras) -> CommonSupport:
    limits = StandingSettings.current()
    contacts, levels = [], []
    for obj in standing:
        hull = obj.T_frame_obj @ obj.solid.hull
        down, _ = obj.solid.resting.nearest(-obj.T_frame_obj.R.T @ normal)
        own = -(obj.T_frame_obj.R @ down)
        levels.append(own)
        along = hull @ own
        contacts.append(hull[along <= along.min() + limits.touches_m])
    # Each object has the same total weight, independent of its mesh resolution.
    middles = np.array([c.mean(axis=0) for c in contacts])
    weight = np.concatenate([np.full(len(c), 1 / len(c)) for c in contacts])
    points = np.concatenate(contacts)
    middle = middles.mean(axis=0)
    centred = points - middle
    spread, axes = np.linalg.eigh((centred * weight[:, None]).T @ centred / len(contacts))
    level = np.mean(levels, axis=0)
    level /= np.linalg.norm(level)
    if len(standing) > 1 and np.sqrt(max(spread[1], 0.0)) > limits.wide_m:
        level = axes[:, 0] if axes[:, 0] @ level > 0 else -axes[:, 0]
    offset = -float(level @ middle)
    distance = points @ level + offset
    rms = float(np.sqrt(np.average(distance**2, weights=weight)))
    names = tuple(t.name for t in standing)
    upright = float((cameras.up @ level).mean())
    return CommonSupport(level, offset, points, names, rms, upright)


@dataclass(frozen=True, eq=False)
class Cameras:
    """Camera positions and orientations in the common frame.

    Attributes:
        centres: (M, 3) metres.
        up: (M, 3) upward direction of each image.
    """

    centres: Array
    up: Array

    @staticmethod
    def of(poses: Sequence[SE3]) -> Cameras:
        """Build from T_frame_cam of each camera."""
        return Cameras(np.array([T.t for T in poses]), np.array([-T.R[:, 1] for T in poses]))


@dataclass(frozen=True, eq=False)
class SupportScore:
    """Score of a plane `normal . p + offset = 0` as support.

    Attributes:
        normal, offset: the plane, with the normal towards the cameras.
        score: 0 if it cannot be a support; higher is better.
        upright: mean cosine between the normal and the upward direction of the images.
        height_m: median height of the cameras above the plane, metres.
        carried: names of the objects that stand on it.
    """

    normal: Array
    offset: float
    score: float
    upright: float
    height_m: float
    carried: tuple[str, ...]


def score_support(
    normal: Array,
    offset: float,
    weight: float,
    middle: Array,
    cameras: Cameras,
    objects: Sequence[PlacedObject],
) -> SupportScore:
    """Score a plane `normal . p + offset = 0` as the support of the objects.

    Args:
        normal, offset: the plane.
        weight: fraction of the points in the plane.
        middle: (3,) mean of these points.
        cameras: cameras of the views.
        objects: placed objects.
    """
    limits = StandingSettings.current()
    heights = cameras.centres @ normal + offset
    if np.median(heights) < 0:
        normal, offset, heights = -normal, -offset, -heights
    height = float(np.median(heights))
    upright = float((cameras.up @ normal).mean())
    # Every camera must be above the table.
    score = weight if (heights > 0.02).all() else 0.0
    if upright < limits.upright:
        score *= 0.7 if upright > limits.sideways else 0.3
    sight = np.linalg.norm(cameras.centres - middle, axis=1)
    if float(np.median(heights / np.maximum(sight, 1e-6))) < limits.edge_on:
        score *= 0.3
    lows = {t.name: float((t.T_frame_obj @ t.solid.hull @ normal + offset).min()) for t in objects}
    carried = tuple(
        n for n, low in lows.items() if abs(low) <= limits.meets_m + limits.sensor_bias * height
    )
    if objects:
        score *= 0.1 + len(carried) / len(objects)
    return SupportScore(normal, offset, score, upright, height, carried)
