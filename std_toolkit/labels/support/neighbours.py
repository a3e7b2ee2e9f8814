"""The table as placed objects tell it: the plane on which most of them stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.labels.support.judge import Cameras, judge
from std_toolkit.labels.support.solid import PlacedThing

Array = NDArray[np.float64]
# How exactly hand-made labels stand: standard deviations of height and slope.
_UNEVEN_M = 0.006
_SLANT = np.radians(6.0)
# An object stands on the plane if it is likely by this much, relative to an exact fit.
_LIKELY = 0.2
_CUT_M = 0.015
_TOUCHES_M = 0.0015
# Below this spread the contacts do not fix the plane's slope by themselves.
_WIDE_M = 0.03


@dataclass(frozen=True, eq=False)
class CommonSupport:
    """A plane `normal . p + offset = 0` under some objects.

    Attributes:
        contacts: (N, 3) lowest points of the objects that stand on it.
        standing: names of these objects.
        rms_m: of the contacts' distances.
        upright: mean cosine between the normal and the images' upward direction.
    """

    normal: Array
    offset: float
    contacts: Array
    standing: tuple[str, ...]
    rms_m: float
    upright: float


def common_support(things: Sequence[PlacedThing], cameras: Cameras) -> CommonSupport | None:
    """The plane on which most objects stand level; None if no camera looks at one from above."""
    best: tuple[float, Array, list[PlacedThing]] | None = None
    for thing in things:
        faces = thing.solid.resting
        for down, steady in zip(faces.down, faces.steady, strict=True):
            normal = -(thing.T_frame_obj.R @ down)
            hull = thing.T_frame_obj @ thing.solid.hull
            offset = -float((hull @ normal).min())
            foot = hull[(hull @ normal).argmin()]
            view = judge(normal, offset, 1.0, foot, cameras, ())
            if view.score == 0 or view.normal @ normal < 0:
                continue
            likely, cut = _standing(things, normal, offset)
            # Among planes with as many objects the one that the cameras see from above, then the
            # one on which the object stands more firmly.
            merit = float(likely.sum()) - 2 * cut + 0.6 * view.score + 0.3 * min(float(steady), 1.0)
            if best is None or merit > best[0]:
                standing = [t for t, p in zip(things, likely, strict=True) if p > _LIKELY]
                best = merit, normal, standing
    if best is None or not best[2]:
        return None
    return _fitted(best[1], best[2], cameras)


def _standing(things: Sequence[PlacedThing], normal: Array, offset: float) -> tuple[Array, int]:
    """How likely each object stands level on a plane, 0 to 1, and how many the plane cuts."""
    likely, cut = np.zeros(len(things)), 0
    for i, thing in enumerate(things):
        low = float((thing.T_frame_obj @ thing.solid.hull @ normal + offset).min())
        _, tilt = thing.solid.resting.nearest(-thing.T_frame_obj.R.T @ normal)
        likely[i] = np.exp(-0.5 * ((low / _UNEVEN_M) ** 2 + (tilt / _SLANT) ** 2))
        cut += low < -_CUT_M
    return likely, cut


def _fitted(normal: Array, standing: Sequence[PlacedThing], cameras: Cameras) -> CommonSupport:
    contacts, levels = [], []
    for thing in standing:
        hull = thing.T_frame_obj @ thing.solid.hull
        down, _ = thing.solid.resting.nearest(-thing.T_frame_obj.R.T @ normal)
        own = -(thing.T_frame_obj.R @ down)
        levels.append(own)
        along = hull @ own
        contacts.append(hull[along <= along.min() + _TOUCHES_M])
    # One vote per object, however finely its foot is meshed.
    middles = np.array([c.mean(axis=0) for c in contacts])
    weight = np.concatenate([np.full(len(c), 1 / len(c)) for c in contacts])
    points = np.concatenate(contacts)
    middle = middles.mean(axis=0)
    centred = points - middle
    spread, axes = np.linalg.eigh((centred * weight[:, None]).T @ centred / len(contacts))
    level = np.mean(levels, axis=0)
    level /= np.linalg.norm(level)
    if len(standing) > 1 and np.sqrt(max(spread[1], 0.0)) > _WIDE_M:
        level = axes[:, 0] if axes[:, 0] @ level > 0 else -axes[:, 0]
    offset = -float(level @ middle)
    distance = points @ level + offset
    rms = float(np.sqrt(np.average(distance**2, weights=weight)))
    names = tuple(t.name for t in standing)
    upright = float((cameras.up @ level).mean())
    return CommonSupport(level, offset, points, names, rms, upright)
